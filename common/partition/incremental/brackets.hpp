// Brackets: the intervals in which a new search is expected to find a tree's cuts, guessed before any particle is
// looked at. The loads tell exactly how far each cut is off its target; a sample tells how far that is in space. A
// part's inner region is what no bracket reaches: the particles in it are expected to stay.
//
// Invariants
// 1. A wrong guess costs time only: the search verifies that particles really stay (interior.hpp).
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/comm/comm.hpp"
#include "common/geometry/box.hpp"
#include "common/particles/block_ranges.hpp"
#include "common/partition/balance/load.hpp"
#include "common/partition/search/request.hpp"
#include "common/partition/search/splitters.hpp"

namespace rcb::partition {

// The parts [first, last) that this rank owns: its particles are of these parts, but for some that have just left them.
// Where particles may lie on any rank: all parts, on every rank.
struct OwnParts {
  int first = 0;
  int last = 0;
};

// The partition that is in force.
struct CurrentPartition {
  const CutTree& tree;
  std::span<const std::int32_t> part;  // of the local particles, under the tree
  const LoadSummary& loads;            // of those parts, all ranks
  OwnParts own;
  const particles::BlockRanges* blocks = nullptr;  // the ranges of the local positions; null: not known
};

struct InnerRegions {
  std::vector<geometry::Box> boxes;  // [own parts]: open boxes, some unbounded, some empty
  Splitters splitters;               // the brackets of the upper cuts, the same on all ranks
};

//   count    of all ranks' particles
//   options  those of the tree
// Collective (two gathers, the first of a sample of some thousand particles).
InnerRegions inner_regions(comm::Comm& comm, const particles::ParticleView& particles, const CurrentPartition& current,
                           std::uint64_t count, const PartitionOptions& options);

}  // namespace rcb::partition
