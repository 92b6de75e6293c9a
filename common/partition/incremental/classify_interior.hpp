// One pass over all particles that have parts: which are expected to stay in theirs (interior), and which few have to
// be searched (boundary).
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/particles/block_ranges.hpp"
#include "common/partition/balance/load.hpp"
#include "common/partition/incremental/brackets.hpp"
#include "common/partition/search/interior.hpp"

namespace rcb::partition {

struct OwnInterior {
  bool too_many = false;             // the pass stopped at boundary_max: the rest is meaningless
  particles::ParticleSet boundary;   // the boundary particles, copied, but without ids: few searches need these
  Buffer<std::uint64_t> slot;        // their slots, ascending
  Buffer<std::int32_t> part;         // and their current parts
  std::vector<geometry::Box> boxes;  // [own parts]: the exact boxes of the interior particles; empty: none

  // The boundary particles, copied from these.
  particles::ParticleView view(const particles::ParticleView& of) const;
};

// inner: the inner regions of this rank's own parts; a particle strictly inside that of its part is interior. Particles
// of other ranks' parts are boundary particles.
//   blocks  the ranges of these positions; null: not known
// Local. Reads every position once, except in blocks whose ranges show that all their particles stay; stops at more
// than boundary_max boundary particles, since these are copied.
OwnInterior classify_interior(const particles::ParticleView& particles, const particles::BlockRanges* blocks,
                              std::span<const std::int32_t> part, std::span<const geometry::Box> inner, OwnParts own,
                              std::size_t boundary_max);

// The interior particles of all ranks. nullopt, on every rank, if boundary particles are more than `most` or one rank
// has too many. Collective (one gather).
//   loads     of all particles, all ranks
//   boundary  grows by the number of boundary particles of all ranks
std::optional<Interior> sum_interior(comm::Comm& comm, const OwnInterior& own, OwnParts parts, const LoadSummary& loads,
                                     std::uint64_t most, std::uint64_t& boundary);

}  // namespace rcb::partition
