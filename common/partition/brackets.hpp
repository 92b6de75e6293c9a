// Brackets: where a tree's cuts will lie once they are searched again, guessed before any particle is looked at. The
// loads tell exactly how far each cut is off its target; a sample tells how far that is in space. A part's inner region
// is what no bracket reaches: the particles in it are expected to stay.
//
// Invariants
// 1. Nothing depends on a guess but time: whether particles really stay is found by the search (settled.hpp).
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/geometry/box.hpp"
#include "common/partition/comm.hpp"
#include "common/partition/cut_tree.hpp"
#include "common/partition/partition.hpp"

namespace rcb::partition {

// The parts [first, last) that this rank's particles are of, but for some that have just left them. Where particles lie
// anywhere that is all parts, on every rank.
struct OwnParts {
  int first = 0;
  int last = 0;
};

// The inner regions of this rank's own parts, [last - first]; open boxes, some unbounded, some empty. Those of parts of
// no root are all there is.
//   part   [particles.count]: the particles' parts under the tree
//   count  of all ranks' particles
//   loads  of each part, all ranks; only their proportions count
//   roots  nodes to be cut again; the others' cuts stay
// Collective (one gather of a sample of some thousand particles).
std::vector<geometry::Box> inner_regions(Comm& comm, const particles::ParticleView& particles,
                                         std::span<const std::int32_t> part, const CutTree& tree, std::uint64_t count,
                                         std::span<const double> loads, std::span<const NodeRange> roots, OwnParts own,
                                         const SearchLimits& limits);

}  // namespace rcb::partition
