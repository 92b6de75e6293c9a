// The one pass of a repartition: which particles are expected to stay in their part, and which few are to be looked at.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/partition/brackets.hpp"

namespace rcb::partition {

struct OwnSettled {
  Buffer<std::uint64_t> few;                                // the others' slots, ascending
  std::array<Buffer<double>, geometry::kDimsMax> position;  // and positions
  std::vector<geometry::Box> boxes;                         // [own parts]: of those who stay, exact; empty: nobody does
};

// inner: of this rank's own parts; a particle strictly inside its part's stays. Those of other parts are among the few.
// Local. One read of the positions.
OwnSettled settle(const particles::ParticleView& particles, std::span<const std::int32_t> part,
                  std::span<const geometry::Box> inner, OwnParts own);

}  // namespace rcb::partition
