// Session, part 2: pushes. Their rows are read straight into their arrays, once the push is admitted.
#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include "server/net/control/session.hpp"

namespace rcb::net {

using wire::Json;

namespace {

// Bytes reserved at once; beyond that, the array grows as bytes arrive.
constexpr std::size_t kRoomAtOnce = std::size_t{64} << 20U;
constexpr std::uint64_t kReadAtOnce = std::uint64_t{1} << 20U;

}  // namespace

Status Session::check_way(const Json& push) const {
  const Json way = push.value("way", Json());
  if ((way != "sockets" && way != "shared-memory") || !coordinator_->data_addresses(entrance_.endpoint).empty())
    return {};
  return {Code::unsupported, "clients of this endpoint can't reach the ranks", "push by the way \"endpoint\""};
}

Asker Session::asker(const Request& request) const {
  return {connection_, client_, request.number, request.end, request.held};
}

awaitable<void> Session::push(Request& request) {
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
  if (status.ok() && coordinator_->shutting_down()) status = {Code::unavailable, "the service is shutting down"};
  std::shared_ptr<Block> block;
  if (status.ok()) status = check_way(request.json);
  if (status.ok()) {
    auto begun = groups.begin(*id, asker(request), request.json, request.unread->header.bulk_bytes);
    status = begun.status();
    if (begun.ok()) block = std::move(*begun);
  }
  if (id.ok()) coordinator_->wake_queue(id->scene);
  if (!status.ok()) fail(request.number, status);
  request.opened = block != nullptr;
  if (!block || !block->rows_missing) co_return;
  --answering_;  // from here on the step's end answers it
  request.breach = co_await receive(*std::exchange(request.unread, nullptr), *block);
  ++answering_;
  connection_->limit_reading(TimePoint::max());  // which a block that is given up sets
  if (!request.breach.ok() || block->given_up) co_return;
  block->rows_missing = false;
  groups.block_whole(*block);
}

awaitable<Status> Session::receive(const Frame& frame, Block& block) {
  const bool checked = (frame.header.flags & wire::kFlagBulkChecksum) != 0;
  wire::BulkChecksum checksum;
  std::uint64_t left = frame.header.bulk_bytes;
  Slice& slice = *block.slice;
  for (wire::Array& array : slice.arrays) {
    const bool single = array.dtype == "<f4";  // float32, widened to doubles as it arrives
    const std::uint64_t bytes = slice.count * 8;
    while (array.bytes.size() < bytes) {
      const std::size_t old = array.bytes.size();
      // In pieces, so that what has come is charged soon, and the memory of a push that is given up is soon free.
      const std::size_t next = std::min<std::uint64_t>(bytes, old + kReadAtOnce);
      const std::size_t room = std::min<std::uint64_t>(bytes, std::max(kRoomAtOnce, 2 * old));
      if (!block.given_up && next > array.bytes.capacity() && !array.bytes.try_reserve(room))
        coordinator_->groups().abort(
            block, {Code::too_large, fmt::format("no memory for the {} bytes of array '{}'", bytes, array.name)});
      if (block.given_up) {
        slice.arrays.clear();  // `array` is invalid from here on
        connection_->limit_reading(TimePoint::max());
        co_return co_await connection_->skip_bulk(frame, left);
      }
      array.bytes.resize(next);
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
  co_return co_await check_sum(frame, checksum, "a push");
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
