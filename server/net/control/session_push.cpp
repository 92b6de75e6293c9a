// Session, part 2: pushes. push.begin is checked against the snapshot, slices are read straight into their arrays, and
// the last one submits the order. Until then the scene is unchanged.
#include <algorithm>
#include <utility>

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include "server/api/ledger_answers.hpp"
#include "server/net/control/push_order.hpp"
#include "server/net/control/session.hpp"

namespace rcb::net {

using wire::Json;

namespace {

// Bytes reserved at once; beyond that, the array grows as bytes arrive.
constexpr std::size_t kRoomAtOnce = std::size_t{64} << 20U;

}  // namespace

Status Session::check_path(const Json& begin) const {
  const Json path = begin.value("path", Json());
  if ((path != "direct" && path != "shared") || !coordinator_->data_addresses(entrance_.endpoint).empty()) return {};
  return {Code::unsupported, "this endpoint has no direct path", "push by the path \"gateway\""};
}

Status Session::push_conflict(const SceneGate& gate, const PushId& id) {
  if (Status free = coordinator_->groups().check_free(id.scene); !free.ok()) return free;
  if (!gate.push) return {};
  const PushId& open = gate.push->slices.terms().id;
  if (open.session == id.session) {
    if (open.step != id.step || open.attempt <= id.attempt) return {};
    return {Code::aborted,
            fmt::format("attempt {} of step {} is open, which is newer than {}", open.attempt, open.step, id.attempt)};
  }
  return {Code::busy,
          fmt::format("'{}' has had a push of scene '{}' open for {:.1f} s ({})", gate.push->client, id.scene,
                      seconds_since(gate.push->started), gate.push->progress()),
          "try again when it is done"};
}

awaitable<void> Session::push_begin(Request& request) {
  const Result<PushId> id = read_push_id(request.json, number_);
  if (!id.ok()) {
    fail(request.number, id.status());
    co_return;
  }
  if (coordinator_->groups().knows(id->scene, connection_.get())) co_return co_await begin_contribution(request, *id);
  SceneGate& gate = coordinator_->gate(id->scene);
  Status status = push_conflict(gate, *id);
  if (status.ok() && gate.push)
    coordinator_->abort(gate.push, {Code::aborted, "a newer attempt of the same session replaced it"});
  if (status.ok()) {
    SceneGate& now_at = coordinator_->gate(id->scene);  // the abort may have erased the gate
    status = co_await wait_turn(request, id->scene, [&now_at] { return now_at.changes_unfinished == 0; });
  }
  if (const scene::Ledger* ledger = status.ok() ? coordinator_->scenes().find(id->scene) : nullptr)
    if (const auto number = ledger->repeated(id->session, id->step)) {
      coordinator_->wake_queue(id->scene);
      refuse_slices(request.command, request.json);
      co_return send_later(request, api::repeated(*ledger, *number));
    }
  std::shared_ptr<OpenPush> push;
  if (status.ok()) {
    Result<std::shared_ptr<OpenPush>> admitted = admit_push(request, *id);
    if (admitted.ok()) push = std::move(*admitted);
    status = admitted.status();
  }
  coordinator_->wake_queue(id->scene);
  if (!status.ok()) refuse(request, status);
  if (!push) co_return;
  if (push->slices.terms().direct()) begin_directly(push);
  if (push->ready()) co_await order_push(push);
}

awaitable<void> Session::begin_contribution(Request& request, const PushId& id) {
  SceneGate& gate = coordinator_->gate(id.scene);
  const auto ready = [&gate] { return gate.changes_unfinished == 0 && !gate.push; };
  const auto joins = [&gate] { return gate.push && gate.push->round; };
  Status status = co_await wait_turn(request, id.scene, ready, joins);
  const bool slices = may_bring_slices(request.json);
  if (status.ok()) status = check_path(request.json);
  if (status.ok())
    status = coordinator_->groups().begin(
        {id, connection_, client_, request.number, std::move(request.json), request.end, request.held});
  coordinator_->wake_queue(id.scene);
  if (status.ok()) co_return;
  if (slices) coordinator_->refuse_directly(id);
  fail(request.number, status);
}

void Session::begin_directly(const std::shared_ptr<OpenPush>& push) {
  // The session goes on reading, so that it notices when the client leaves; the answer is sent when the ranks are
  // ready.
  push->on_complete = [self = shared_from_this(), weak = std::weak_ptr(push)] {
    const auto ready = weak.lock();
    if (!ready) return;
    asio::co_spawn(
        self->coordinator_->context(), [self, ready] { return self->order_push(ready); },
        [self](const std::exception_ptr& fault) {  // the client notices by the end of its connection
          if (fault) self->connection_->close();
        });
  };
  coordinator_->receive_directly(push);
}

Result<std::shared_ptr<OpenPush>> Session::admit_push(const Request& request, const PushId& id) {
  const SceneGate& gate = coordinator_->gate(id.scene);
  const Status conflict = push_conflict(gate, id);
  if (!conflict.ok()) return conflict;
  if (gate.push) coordinator_->abort(gate.push, {Code::aborted, "a newer attempt of the same session replaced it"});
  const scene::Ledger* ledger = coordinator_->scenes().find(id.scene);
  if (ledger == nullptr) return coordinator_->unknown_scene(id.scene);
  if (Status path = check_path(request.json); !path.ok()) return path;
  Result<PushTerms> terms = read_push_terms(request.json, id, ledger->now(), coordinator_->options().ranks,
                                            coordinator_->options().bulk_bytes_max);
  if (!terms.ok()) return terms.status();
  const double left = std::chrono::duration<double>(request.end - now()).count();
  auto push = coordinator_->open_push(std::move(*terms), connection_, client_, left);
  push->request = request.number;
  push->begin = request.json;
  push->held = request.held;
  return push;
}

awaitable<Status> Session::push_slice(Frame frame) {
  const Result<PushId> id = read_push_id(frame.json, number_);
  const auto push = id.ok() ? coordinator_->find_push(*id, connection_.get()) : nullptr;
  if (!push) co_return co_await connection_->skip_bulk(frame, frame.header.bulk_bytes);
  Result<Slice> slice = push->slices.begin_slice(frame.json, frame.header.bulk_bytes);
  if (!slice.ok()) {
    coordinator_->abort(push, slice.status());
    if (slice.status().code() == Code::protocol_error) co_return slice.status();
    co_return co_await connection_->skip_bulk(frame, frame.header.bulk_bytes);
  }
  Status status = co_await receive(frame, push, *slice);
  if (!status.ok() || push->given_up) co_return status;
  push->slices.add(std::move(*slice));
  if (push->round)
    coordinator_->groups().contribution_whole(push);
  else
    co_await order_push(push);
  co_return Status();
}

awaitable<Status> Session::receive(const Frame& frame, const std::shared_ptr<OpenPush>& push, Slice& slice) {
  const bool checked = (frame.header.flags & wire::kFlagBulkChecksum) != 0;
  wire::BulkChecksum checksum;
  std::uint64_t left = frame.header.bulk_bytes;
  for (wire::Array& array : slice.arrays) {
    const bool single = array.dtype == "<f4";  // float32, widened to doubles as it arrives
    const std::uint64_t bytes = slice.count * 8;
    while (array.bytes.size() < bytes) {
      const std::size_t old = array.bytes.size();
      const std::size_t room = std::min<std::uint64_t>(bytes, std::max(kRoomAtOnce, 2 * old));
      if (!push->given_up && !array.bytes.try_reserve(room))
        coordinator_->abort(
            push, {Code::too_large, fmt::format("no memory for the {} bytes of array '{}'", bytes, array.name)});
      if (push->given_up) {
        slice.arrays.clear();  // `array` is invalid from here on
        co_return co_await connection_->skip_bulk(frame, left);
      }
      array.bytes.resize(room);
      const std::span<std::byte> room_made = array.bytes.span().subspan(old);
      const std::span<std::byte> piece = single ? room_made.last(room_made.size() / 2) : room_made;
      const Status status = co_await connection_->read_bulk(piece);
      if (!status.ok()) co_return status;
      if (!push->given_up) coordinator_->charge(push, room_made.size());
      if (checked) checksum.add(piece);
      if (single) widen(piece, room_made);
      left -= piece.size();
    }
    if (single) array.dtype = "<f8";
  }
  co_return co_await check_sum(frame, checksum, "a slice");
}

awaitable<Status> Session::check_sum(const Frame& frame, const wire::BulkChecksum& checksum, const char* whose) {
  if ((frame.header.flags & wire::kFlagBulkChecksum) == 0) co_return Status();
  std::array<std::byte, 8> sent{};
  const Status status = co_await connection_->read_bulk(sent);
  if (!status.ok()) co_return status;
  if (wire::BulkChecksum::decode(sent) != checksum.value())
    co_return Status(Code::protocol_error, fmt::format("the checksum of {}'s arrays doesn't match", whose));
  co_return Status();
}

awaitable<void> Session::order_push(std::shared_ptr<OpenPush> push) {
  if (push->closed) co_return;  // aborted since it was complete
  const PushId id = push->slices.terms().id;
  Request request{push->request, api::find_command("push.begin"), "push", {{"scene", id.scene}}, 0, push->end};
  request.deadline_seconds = std::max(std::chrono::duration<double>(push->end - push->started).count(), 0.0);
  auto [json, order] = order_of(std::span(&push, 1), 0, *coordinator_->scenes().find(id.scene));
  json["deadline_seconds"] = order.deadline_seconds = request.deadline_seconds;
  order.received_seconds = seconds_since(push->started);
  order.held = std::move(push->held);
  coordinator_->close_push(push);
  Result<std::shared_ptr<Pending>> pending = coordinator_->order(std::move(json), std::move(order));
  coordinator_->erase_gate_if_unused(id.scene);
  if (pending.ok()) co_return co_await reply_when_done(request, *pending);
  if (push->number != 0) coordinator_->refuse_directly(id);
  fail(request.number, pending.status());
}

}  // namespace rcb::net
