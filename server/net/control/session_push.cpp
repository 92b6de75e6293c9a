// Session, part 2: pushes. Slices are read straight into their arrays.
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

awaitable<void> Session::push_begin(Request& request) {
  SeatGroups& groups = coordinator_->groups();
  const Result<PushId> id = read_push_id(request.json, number_);
  const auto role = id.ok() ? groups.role_of(*id, connection_.get()) : id.status();
  Status status = role.status();
  if (status.ok()) {
    SceneGate& gate = coordinator_->gate(id->scene);
    const auto ready = [&gate] { return gate.changes_unfinished == 0; };
    const auto joins = [&gate, by = role->by] { return gate.step && gate.step->by == by; };
    status = co_await wait_turn(request, id->scene, ready, joins);
  }
  if (status.ok()) status = check_path(request.json);
  if (status.ok())
    status = groups.begin({*id, connection_, client_, request.number, request.json, request.end, request.held});
  if (id.ok()) coordinator_->wake_queue(id->scene);
  if (!status.ok()) refuse(request, status);
}

awaitable<Status> Session::push_slice(Frame frame) {
  const Result<PushId> id = read_push_id(frame.json, number_);
  const auto push = id.ok() ? coordinator_->find_block(*id, connection_.get()) : nullptr;
  if (!push) co_return co_await connection_->skip_bulk(frame, frame.header.bulk_bytes);
  Result<Slice> slice = push->slices.begin_slice(frame.json, frame.header.bulk_bytes);
  if (!slice.ok()) {
    coordinator_->groups().abort(*push, slice.status());
    if (slice.status().code() == Code::protocol_error) co_return slice.status();
    co_return co_await connection_->skip_bulk(frame, frame.header.bulk_bytes);
  }
  Status status = co_await receive(frame, *push, *slice);
  if (!status.ok() || push->given_up) co_return status;
  push->slices.add(std::move(*slice));
  coordinator_->groups().block_whole(*push);
  co_return Status();
}

awaitable<Status> Session::receive(const Frame& frame, Block& block, Slice& slice) {
  const bool checked = (frame.header.flags & wire::kFlagBulkChecksum) != 0;
  wire::BulkChecksum checksum;
  std::uint64_t left = frame.header.bulk_bytes;
  for (wire::Array& array : slice.arrays) {
    const bool single = array.dtype == "<f4";  // float32, widened to doubles as it arrives
    const std::uint64_t bytes = slice.count * 8;
    while (array.bytes.size() < bytes) {
      const std::size_t old = array.bytes.size();
      const std::size_t room = std::min<std::uint64_t>(bytes, std::max(kRoomAtOnce, 2 * old));
      if (!block.given_up && !array.bytes.try_reserve(room))
        coordinator_->groups().abort(
            block, {Code::too_large, fmt::format("no memory for the {} bytes of array '{}'", bytes, array.name)});
      if (block.given_up) {
        slice.arrays.clear();  // `array` is invalid from here on
        co_return co_await connection_->skip_bulk(frame, left);
      }
      array.bytes.resize(room);
      const std::span<std::byte> room_made = array.bytes.span().subspan(old);
      const std::span<std::byte> piece = single ? room_made.last(room_made.size() / 2) : room_made;
      const Status status = co_await connection_->read_bulk(piece);
      if (!status.ok()) co_return status;
      if (!block.given_up) coordinator_->charge(block, room_made.size());
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

}  // namespace rcb::net
