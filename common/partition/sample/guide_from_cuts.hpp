// A guide for the particles of a partition that is in force. The loads tell exactly how far each of its cuts is off its
// target; a sample tells how far that is in space.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/comm/comm.hpp"
#include "common/particles/block_ranges.hpp"
#include "common/partition/balance/load.hpp"
#include "common/partition/rules/request.hpp"
#include "common/partition/sample/guide.hpp"

namespace rcb::partition {

// The partition that is in force.
struct CurrentPartition {
  const CutTree& tree;
  std::span<const std::int32_t> part;              // of the local particles, under the tree
  const LoadSummary& loads;                        // of those parts, all ranks
  const particles::BlockRanges* blocks = nullptr;  // the ranges of the local positions; null: not known
};

struct GuideFromCuts {
  Guide guide;
  // [parts]: what no bracket reaches, where the part's particles are expected to stay: open boxes, some unbounded, some
  // empty.
  std::vector<geometry::Box> inner;
};

//   count    of all ranks' particles
//   options  those of the tree
// Collective (one gather of a sample of some thousand particles, one broadcast).
GuideFromCuts guide_from_cuts(comm::Comm& comm, const particles::ParticleView& particles,
                              const CurrentPartition& current, std::uint64_t count, const PartitionOptions& options,
                              SearchCost& cost);

}  // namespace rcb::partition
