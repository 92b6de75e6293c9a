// Ghosts and neighbours: for each part, the particles of other parts near its particles' bounding box, and the number
// of parts that own them. Found by a tree of the boxes: a particle that is near all boxes of a subtree is counted there
// once, for all of its parts, so the widest ghosts cost no more than narrow ones.
//
// Memory beyond a few numbers a part is bounded, however many pairs of parts are neighbours: the owners are taken in
// one order on all ranks, and what is known of an owner whose particles have been looked at everywhere is counted and
// let go.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/geometry/box.hpp"
#include "common/particles/particle_set.hpp"
#include "common/partition/comm.hpp"

namespace rcb::partition {

struct GhostCounts {
  std::vector<std::uint64_t> ghosts;     // per part: particles of other parts within the width (maximum norm)
  std::vector<std::int32_t> neighbours;  // per part: how many parts own those
};

struct GhostLimits {
  std::uint64_t round_visits = std::uint64_t{1} << 21U;  // boxes looked at between two questions whether to go on
  std::size_t pending_max = std::size_t{1} << 19U;  // ranges of parts that a rank keeps for other ranks to catch up
};

// False where go_on said so: `counts` is not to be used. Collective.
//   part  [particles.count], 0 .. parts - 1
bool count_ghosts(Comm& comm, const particles::ParticleView& particles, std::span<const std::int32_t> part, int parts,
                  double width, const GoOn& go_on, GhostCounts& counts, const GhostLimits& limits = {});

}  // namespace rcb::partition
