// Small pieces that the commands share: collectives, and the order of gathered particles.
#pragma once

#include <array>
#include <cstring>
#include <optional>
#include <span>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/base/status.hpp"
#include "common/particles/particle_set.hpp"
#include "common/partition/comm.hpp"

namespace rcb::service {

// The failure of the lowest rank that has one, on every rank; ok if all are. Collective.
Status agree_status(partition::Comm& comm, const Status& here);

// Which particle is the k-th in ascending id. Ids come in few ascending runs (one from each rank), so runs are merged
// two by two. Local.
Buffer<std::uint64_t> order_by_id(const Buffer<particles::Id>& ids);
// Puts slots (32 or 64 bits each) of particles with these ids into the ids' order. Local.
template <typename Slot>
void sort_slots_by_id(Buffer<Slot>& slots, std::span<const particles::Id> ids);

// The smallest id that occurs twice among all ranks' ids; nothing if all are distinct. Collective.
std::optional<particles::Id> duplicate_id(partition::Comm& comm, std::span<const particles::Id> ids);

// Every rank's values in rank order, on rank 0 alone. Collective.
template <typename T>
Buffer<T> gather_values(partition::Comm& comm, std::span<const T> values) {
  std::vector<std::byte> all;
  std::vector<std::size_t> sizes;
  comm.gather(std::as_bytes(values), 0, all, sizes);
  Buffer<T> out(all.size() / sizeof(T));
  if (!all.empty()) std::memcpy(out.data(), all.data(), all.size());
  return out;
}

}  // namespace rcb::service
