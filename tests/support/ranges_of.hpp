// The ranges of all blocks of some particles, as a step makes them while the positions arrive.
#pragma once

#include "common/particles/block_ranges.hpp"

namespace rcb::testing {

inline particles::BlockRanges ranges_of(const particles::ParticleView& view) {
  particles::BlockRanges ranges;
  RCB_CHECK(ranges.try_reset(view.dims, view.count), "there is memory");
  for (std::size_t a = 0; a < static_cast<std::size_t>(view.dims); ++a)
    ranges.extend(a, 0, {view.position[a], view.count});
  return ranges;
}

}  // namespace rcb::testing
