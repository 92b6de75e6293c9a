// Guide: what all ranks know before the pass over their particles: where the upper cuts are expected, and how
// coordinates become integers. For a set without cuts a sample tells it (guide.cpp). Of cuts in force the loads tell
// exactly how far each is off its target, and a sample how far that is in space (guide_from_cuts.cpp).
#pragma once

#include <array>
#include <cstdint>

#include "common/particles/block_ranges.hpp"
#include "common/partition/balance/load.hpp"
#include "common/partition/points/axis_map.hpp"
#include "common/partition/sample/sample.hpp"

namespace rcb::partition {

// Trivially copyable: it is sent as it is.
struct Guide {
  Splitters splitters;
  std::array<AxisPlan, geometry::kDimsMax> axes;
  bool split = false;  // there are splitters

  // With splitters that aren't known yet. Local.
  static Guide of_sample(Sample sample, const geometry::Box& box, int dims);
  // If all are by value, those that were lossless for the sampled coordinates count as lossless, until a pass over all
  // particles shows that they aren't (reduce_lossless()). Local.
  AxisMaps maps(int dims) const;
};

// What is known of a whole set before the pass.
struct SetGuide {
  Guide guide;
  std::uint64_t count = 0;  // of all particles
  // Without splitters, which then aren't worth their time:
  geometry::Box box;         // of all particles, exact
  particles::Range weights;  // empty: there are none
};

// Large sets are sampled. Of small ones every coordinate is read; under a cut tolerance, where cuts depend on the maps,
// the guide doesn't depend on how the particles are distributed. Adds what it costs to `cost`. Collective (one sum,
// then one gather; with splitters one broadcast, too).
SetGuide guide_of_set(comm::Comm& comm, const particles::ParticleView& particles, const PartitionOptions& options,
                      SearchCost& cost);

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
