// The ranges of all blocks of some particles, as a step makes them while it reads the positions.
#pragma once

#include <algorithm>

#include "common/particles/block_ranges.hpp"

namespace rcb::testing {

inline particles::BlockRanges ranges_of(const particles::ParticleView& view) {
  particles::BlockRanges ranges;
  for (std::size_t a = 0; a < static_cast<std::size_t>(view.dims); ++a)
    for (std::size_t first = 0; first < view.count; first += particles::kBlock)
      ranges.of[a].push_back(
          particles::range_of({view.position[a] + first, std::min(particles::kBlock, view.count - first)}));
  return ranges;
}

}  // namespace rcb::testing
