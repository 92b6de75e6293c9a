// The ranges of all blocks of some particles, as a step makes them while the positions arrive.
#pragma once

#include <algorithm>

#include "common/particles/block_ranges.hpp"

namespace rcb::testing {

inline particles::BlockRanges ranges_of(const particles::ParticleView& view) {
  constexpr std::size_t kBlock = particles::kBlock;
  particles::BlockRanges ranges;
  CHECK(ranges.try_reset(view.dims, view.count), "memory");
  for (std::size_t a = 0; a < static_cast<std::size_t>(view.dims); ++a)
    for (std::size_t begin = 0; begin < view.count; begin += kBlock)
      ranges.of[a][begin / kBlock] =
          particles::range_of({view.position[a] + begin, std::min(kBlock, view.count - begin)});
  return ranges;
}

}  // namespace rcb::testing
