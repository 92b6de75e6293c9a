#include "server/service/context/collective.hpp"

#include <algorithm>
#include <array>
#include <numeric>
#include <random>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "common/base/random.hpp"

namespace rcb::service {
Status agree_status(comm::Comm& comm, const Status& here) {
  const auto size = static_cast<std::uint64_t>(comm.size());
  std::uint64_t first = here.ok() ? size : static_cast<std::uint64_t>(comm.rank());
  comm.all_min({&first, 1});
  if (first == size) return {};
  const int root = static_cast<int>(first);
  const bool mine = comm.rank() == root;
  std::array<std::uint64_t, 3> header{};
  if (mine) header = {static_cast<std::uint64_t>(here.code()), here.message().size(), here.hint().size()};
  comm.broadcast(std::as_writable_bytes(std::span(header)), root);
  std::string text = mine ? here.message() + here.hint() : std::string(header[1] + header[2], '\0');
  comm.broadcast(std::as_writable_bytes(std::span(text)), root);
  return {static_cast<Code>(header[0]), text.substr(0, header[1]), text.substr(header[1])};
}

Status room_for(const comm::Comm& comm, std::uint64_t bytes, const std::string& what) {
  Buffer<std::byte> probe;
  if (probe.try_reserve(bytes)) return {};
  return {Code::too_large, fmt::format("rank {} has no memory for {}", comm.rank(), what)};
}

Status agree_room(comm::Comm& comm, std::uint64_t bytes, const std::string& what) {
  return agree_status(comm, room_for(comm, bytes, what));
}

Status agree_room_to_partition(comm::Comm& comm, std::uint64_t particles, int parts) {
  return agree_status(comm, room_to_partition(comm, particles, parts, 0));
}

Status room_to_partition(const comm::Comm& comm, std::uint64_t particles, int parts, std::uint64_t to_be_freed) {
  constexpr std::uint64_t kBytesOfParticle = 64;  // where it is searched, changes part, leaves and arrives
  constexpr std::uint64_t kBytesOfPart = 1024;    // of the widest level of the tree
  const std::uint64_t bytes = particles * kBytesOfParticle + static_cast<std::uint64_t>(parts) * kBytesOfPart;
  return room_for(comm, bytes - std::min(bytes, to_be_freed),
                  fmt::format("a partition of {} particles into {} parts", particles, parts));
}

void sort_slots_by_id(Buffer<std::uint64_t>& slots, std::span<const particles::Id> ids) {
  std::vector<std::size_t> ends;  // ends of the ascending runs
  for (std::size_t k = 1; k < slots.size(); ++k)
    if (ids[slots[k]] < ids[slots[k - 1]]) ends.push_back(k);
  if (ends.empty()) return;
  ends.push_back(slots.size());
  const auto less = [ids](std::uint64_t a, std::uint64_t b) { return ids[a] < ids[b]; };
  Buffer<std::uint64_t> merged(slots.size());
  while (ends.size() > 1) {
    std::vector<std::size_t> merged_ends;
    std::size_t begin = 0;
    for (std::size_t r = 0; r < ends.size(); r += 2) {
      const std::size_t middle = ends[r];
      const std::size_t end = r + 1 < ends.size() ? ends[r + 1] : middle;
      std::merge(slots.begin() + begin, slots.begin() + middle, slots.begin() + middle, slots.begin() + end,
                 merged.begin() + begin, less);
      merged_ends.push_back(end);
      begin = end;
    }
    slots.swap(merged);
    ends.swap(merged_ends);
  }
}

Buffer<std::uint64_t> order_by_id(const Buffer<particles::Id>& ids) {
  Buffer<std::uint64_t> order(ids.size());
  std::iota(order.begin(), order.end(), std::uint64_t{0});
  sort_slots_by_id(order, ids.span());
  return order;
}

std::uint64_t secret(comm::Comm& comm) {
  std::uint64_t drawn = 0;
  if (comm.rank() == 0) drawn = (std::uint64_t{std::random_device()()} << 32U) + std::random_device()();
  comm.broadcast(std::as_writable_bytes(std::span(&drawn, 1)), 0);
  return drawn;
}

std::optional<particles::Id> duplicate_id(comm::Comm& comm, std::span<const particles::Id> ids,
                                          std::uint64_t& greatest) {
  comm.all_max({&greatest, 1});
  const auto ranks = static_cast<std::uint64_t>(comm.size());
  std::vector<Buffer<particles::Id>> to(ranks);
  const std::uint64_t key = secret(comm);  // else ids could be chosen that one rank would get them all
  for (const particles::Id id : ids) to[mix64(static_cast<std::uint64_t>(id) + key) % ranks].push_back(id);
  std::vector<std::uint64_t> to_counts(ranks), from_counts(ranks);
  for (std::size_t r = 0; r < ranks; ++r) to_counts[r] = to[r].size();
  comm::exchange_counts(comm, to_counts, from_counts);
  std::uint64_t total = 0;
  for (const std::uint64_t count : from_counts) total += count;
  Buffer<particles::Id> mine(total);
  std::vector<std::span<const std::byte>> send;
  std::vector<std::span<std::byte>> receive;
  std::uint64_t at = 0;
  for (std::size_t r = 0; r < ranks; ++r) {
    send.push_back(std::as_bytes(to[r].span()));
    receive.push_back(std::as_writable_bytes(mine.span().subspan(at, from_counts[r])));
    at += from_counts[r];
  }
  comm.exchange(send, receive);
  std::sort(mine.begin(), mine.end());
  const auto* twin = std::adjacent_find(mine.begin(), mine.end());
  std::uint64_t least = twin == mine.end() ? kNone : static_cast<std::uint64_t>(*twin);
  comm.all_min({&least, 1});
  if (least == kNone) return std::nullopt;
  return static_cast<particles::Id>(least);
}

}  // namespace rcb::service
