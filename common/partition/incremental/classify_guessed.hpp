// A first partition's one pass over all particles: the part of each under a guess, which are expected to stay in it
// (interior), and which few have to be searched (boundary).
#pragma once

#include <cstdint>
#include <span>

#include "common/partition/incremental/classify_interior.hpp"
#include "common/partition/incremental/guess.hpp"

namespace rcb::partition {

// Local. Reads every position once; stops at more than boundary_max boundary particles.
//   roots  below which the guess is; other parts are left alone
//   part   the part of each particle so far, if `roots` isn't the whole tree; becomes that under the guess: in nodes
//          where it ends, the node's first part
OwnInterior classify_guessed(const particles::ParticleView& particles, const Guess& guess,
                             std::span<const NodeRange> roots, std::span<std::int32_t> part, std::size_t boundary_max);

}  // namespace rcb::partition
