// The one pass of a repartition: which particles are expected to stay in their part, and which few are to be looked at.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/particles/block_ranges.hpp"
#include "common/partition/brackets.hpp"

namespace rcb::partition {

// to[k] = from[slot[k]].
template <typename T>
void copy_of(const T* from, const Buffer<std::uint64_t>& slot, Buffer<T>& to) {
  to.resize(slot.size());
  for (std::size_t k = 0; k < slot.size(); ++k) to[k] = from[slot[k]];
}

struct OwnSettled {
  bool too_many = false;             // the pass ended at few_max; nothing below counts
  particles::ParticleSet few;        // the others, copied
  Buffer<std::uint64_t> slot;        // their slots, ascending
  Buffer<std::int32_t> part;         // and parts
  std::vector<geometry::Box> boxes;  // [own parts]: of those who stay, exact; empty: nobody does
};

// inner: of this rank's own parts; a particle strictly inside its part's stays. Those of other parts are among the few.
//   blocks  of these positions; null: not known
// Local. One read of the positions, but for blocks whose ranges tell that they stay; ends once more than few_max are to
// be looked at, since they are copied.
OwnSettled settle(const particles::ParticleView& particles, const particles::BlockRanges* blocks,
                  std::span<const std::int32_t> part, std::span<const geometry::Box> inner, OwnParts own,
                  std::size_t few_max);

}  // namespace rcb::partition
