// Helpers that the commands share: collectives, and sorting gathered particles by id.
#pragma once

#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string>

#include "common/base/buffer.hpp"
#include "common/base/status.hpp"
#include "common/comm/gather.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::service {

using comm::gather_values;

// Stands for "none" in a minimum over the ranks: greater than any index or id.
inline constexpr std::uint64_t kNone = std::numeric_limits<std::uint64_t>::max();

// Returns on every rank the failure of the lowest rank that has one; ok if none has. Collective.
Status agree_status(comm::Comm& comm, const Status& here);

// Whether every rank has memory for so many more bytes, each its own number. They are asked for and given back at once:
// the kernel counts them, but no page is touched. Collective. Errors: too_large, which tells what the memory is for.
Status agree_room(comm::Comm& comm, std::uint64_t bytes, const std::string& what);

// The same of this rank alone. Local.
Status room_for(const comm::Comm& comm, std::uint64_t bytes, const std::string& what);

// Likewise for what a partition of this rank's particles and its migration take.
Status agree_room_to_partition(comm::Comm& comm, std::uint64_t particles, int parts);
// The same of this rank alone, which will have freed `to_be_freed` bytes by then. Local.
Status room_to_partition(const comm::Comm& comm, std::uint64_t particles, int parts, std::uint64_t to_be_freed);

// The k-th entry is the index of the particle with the k-th smallest id. Ids come in a few ascending runs (one from
// each rank), so the runs are merged in pairs. Local.
Buffer<std::uint64_t> order_by_id(const Buffer<particles::Id>& ids);
// Sorts slots by the ids of their particles. Local.
void sort_slots_by_id(Buffer<std::uint64_t>& slots, std::span<const particles::Id> ids);

// Reorders an array so that entry k becomes the former entry order[k]. Uses the memory of `spare`, and leaves in
// `spare` as much of the array's former memory as the next array needs.
template <typename T>
void put_in_order(Buffer<T>& values, const Buffer<std::uint64_t>& order, Buffer<std::byte>& spare) {
  Buffer<T> sorted = spare.release_as<T>();
  sorted.resize(order.size());
  for (std::size_t k = 0; k < order.size(); ++k) sorted[k] = values[order[k]];
  spare = values.template release_as<std::byte>();
  spare.resize(std::min(spare.size(), order.size() * sizeof(double)));
  spare.shrink();
  values = std::move(sorted);
  values.shrink();
}

// A random number that no client can guess, the same on all ranks. Collective.
std::uint64_t secret(comm::Comm& comm);

// The smallest id that occurs more than once on all ranks together; nothing if all are distinct. `greatest` becomes
// that of all ranks. Collective.
std::optional<particles::Id> duplicate_id(comm::Comm& comm, std::span<const particles::Id> ids,
                                          std::uint64_t& greatest);

}  // namespace rcb::service
