// Session, part 3: what rank 0 answers from a scene's ledger, with no engine: counts, and queries about steps.
#include <utility>

#include <fmt/format.h>

#include "server/api/ledger_answers.hpp"
#include "server/api/lists.hpp"
#include "server/net/control/session.hpp"

namespace rcb::net {

using wire::FrameType;
using wire::Json;

awaitable<Status> Session::watch(const Request& request, const std::string& scene, std::function<bool()> done,
                                 const std::string& what) {
  SceneGate& gate = coordinator_->gate(scene);
  Place place(gate.watching, coordinator_->context());
  TimePoint notice_at = now() + duration_of(coordinator_->options().notice_seconds);
  while (!done()) {
    if (connection_->peer_is_lost()) co_return Status(Code::aborted, "the client has gone");
    if (coordinator_->shutting_down()) co_return Status(Code::unavailable, "the service is shutting down");
    if (now() >= request.end)
      co_return Status(Code::deadline_exceeded,
                       fmt::format("'{}' waited {} s for {}", request.command, request.deadline_seconds, what));
    co_await nap(place.timer(), request, notice_at, what);
  }
  co_return Status();
}

awaitable<Status> Session::wait_settled(const Request& request, const std::string& scene) {
  SceneGate& gate = coordinator_->gate(scene);
  Status status;
  if (gate.changes_unfinished > 0)
    status = co_await watch(
        request, scene, [&gate] { return gate.changes_unfinished == 0; }, "a change of the scene");
  coordinator_->erase_gate_if_unused(scene);
  co_return status;
}

awaitable<void> Session::answer_from_ledger(Request& request) {
  const auto scene = wire::string_field(request.json, "scene", 256);
  Status status = scene.status();
  // Whoever has lost an answer asks what came of the step, which may still be under way.
  if (status.ok() && request.command == "scene.show") status = co_await wait_settled(request, *scene);
  const scene::Ledger* ledger = status.ok() ? coordinator_->scenes().find(*scene) : nullptr;
  if (status.ok() && ledger == nullptr) status = coordinator_->unknown_scene(*scene);
  if (!status.ok()) co_return reply(request, api::failed(status));
  Answer answer = api::answer_from(*ledger, request.json, coordinator_->options().ranks);
  if (!answer.later) co_return reply(request, std::move(answer));
  // Read from a file by another thread; later requests wait for it, since answers come in the order of requests.
  auto pending = std::make_shared<Pending>(coordinator_->context());
  api::complete(std::move(answer), [pending, coordinator = coordinator_](Answer whole) {
    auto shared = std::make_shared<Answer>(std::move(whole));  // the posted function may be copied
    asio::post(coordinator->context(), [pending, shared] {
      pending->answer = std::move(*shared);
      pending->signal.cancel();
    });
  });
  co_await reply_when_done(request, pending);
}

Status Session::check_positions(const std::string& scene) const {
  const scene::Ledger* ledger = coordinator_->scenes().find(scene);
  if (ledger == nullptr || ledger->now().positions_step == ledger->now().step) return {};
  const auto& held = ledger->now().positions_step;
  if (!held)
    return {Code::invalid_argument,
            fmt::format("the ranks hold no positions of scene '{}' since the service was started", scene),
            "they come with the next step of its solver"};
  return {Code::invalid_argument,
          fmt::format("the ranks hold the positions of step {}, the last step of scene '{}' is {}", *held, scene,
                      *ledger->now().step),
          "its next step that brings positions can be repartitioned; --dry-run tells what the held ones give"};
}

awaitable<Status> Session::wait_for_positions(const Request& request) {
  const std::string scene = request.json.value("scene", Json()).is_string() ? request.json["scene"] : "";
  const auto is_due = [this, scene] {
    const scene::Ledger* ledger = coordinator_->scenes().find(scene);
    return ledger != nullptr && ledger->now().options.positions == scene::Travel::when_needed &&
           ledger->now().positions_step != ledger->now().step && !has_open(scene) &&
           coordinator_->holders(scene, number_).count > 0;
  };
  const auto held = wire::bool_field(request.json, "held");
  if (!held.ok()) co_return held.status();
  if (*held || !is_due()) co_return Status();
  const auto come = [this, scene, is_due] {
    const bool due = is_due();
    if (due) coordinator_->want_positions(scene);
    return !due;
  };
  Status status = co_await watch(request, scene, come, "the positions of the next step");
  coordinator_->erase_gate_if_unused(scene);
  if (status.code() == Code::deadline_exceeded)
    status = {status.code(), status.message(), "take what the ranks hold: --held"};
  co_return status;
}

awaitable<Status> Session::read_record(const Frame& frame, Result<wire::CountRecord>& counted) {
  const auto name = wire::string_field(frame.json, "scene", 256);
  const scene::Ledger* ledger = name.ok() ? coordinator_->scenes().find(*name) : nullptr;
  const std::uint64_t bytes = frame.header.bulk_bytes;
  const int parts = ledger == nullptr ? 0 : ledger->now().options.parts;
  if (bytes > wire::count_record_bytes_most(static_cast<std::uint64_t>(parts))) {
    counted = Status(Code::invalid_argument,
                     fmt::format("count: a record of {} bytes, and the scene has {} parts", bytes, parts));
    co_return co_await connection_->skip_bulk(frame, bytes);
  }
  constexpr std::uint64_t kReadAtOnce = std::uint64_t{64} << 10U;  // as much as a connection takes that only announces
  std::vector<std::byte> record;
  while (record.size() < bytes) {  // memory grows with what comes
    const std::size_t old = record.size();
    record.resize(std::min<std::uint64_t>(bytes, old + kReadAtOnce));
    Status status = co_await connection_->read_bulk(std::span(record).subspan(old));
    if (!status.ok()) co_return status;
  }
  wire::BulkChecksum checksum;
  checksum.add(record);
  if (Status status = co_await check_sum(frame, checksum, "a count"); !status.ok()) co_return status;
  counted = wire::decode_count_record(record);
  co_return Status();
}

awaitable<void> Session::count(Request& request) {
  const auto scene = wire::string_field(request.json, "scene", 256);
  PushId id{scene.ok() ? *scene : "", number_};
  // It keeps nobody waiting, so it need not queue.
  Status status = scene.ok() ? coordinator_->groups().role_of(id, connection_.get()).status() : scene.status();
  if (status.ok()) status = co_await wait_settled(request, id.scene);
  if (status.ok() && !coordinator_->scenes().contains(id.scene)) status = coordinator_->unknown_scene(id.scene);
  auto counted = record_of(request);
  if (api::given(request.json, "fault")) {
    const auto step = wire::integer_field(request.json, "step", 0, wire::kStepMax);
    if (status.ok()) status = step.status();
    if (step.ok()) id.step = *step;
    Status fault = wire::status_from_failure({{"failure", request.json["fault"]}});
    if (fault.code() == Code::internal || fault.code() == Code::protocol_error)  // no code that is known
      fault = {Code::invalid_argument, "field 'fault': expected {\"code\",\"message\"}"};
    counted = std::move(fault);
  } else if (counted.ok()) {
    id.step = counted->step;
  } else if (status.ok()) {
    status = counted.status();
  }
  if (status.ok()) status = coordinator_->groups().count(id, asker(request), std::move(counted));
  if (!status.ok()) reply(request, api::failed(status));
  if (scene.ok()) coordinator_->wake_queue(*scene);
}

Result<scene::CountRecord> Session::record_of(Request& request) const {
  if (!request.counted.ok()) return request.counted.status();
  scene::CountRecord record{std::move(*request.counted), number_};
  record.bytes = request.bytes;
  return record;
}

}  // namespace rcb::net
