// Guide: what all ranks know before the pass over their particles: where the upper cuts are expected, and how
// coordinates become integers. Here for a set of which no cuts are known.
#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "common/comm/comm.hpp"
#include "common/partition/points/axis_map.hpp"
#include "common/partition/sample/bracket.hpp"

namespace rcb::partition {

using AxisPlans = std::array<AxisPlan, geometry::kDimsMax>;

// Trivially copyable: it is sent as it is.
struct Guide {
  Splitters splitters;
  AxisPlans axes;
  bool split = false;  // there are splitters

  // If all are by value, those that were lossless for the sampled coordinates count as lossless, until a pass over all
  // particles shows that they aren't (reduce_lossless()). Local.
  AxisMaps maps(int dims) const;
};

// By a sample that hasn't been divided yet. Local.
AxisPlans plan_axes(const SortedSample& sample);

// nullopt if a sample would save no time, as with few particles or parts. Adds what it costs to `cost`. Collective (one
// sum; then one gather, at most two more, and one broadcast).
std::optional<Guide> guide_of_large_set(comm::Comm& comm, const particles::ParticleView& particles,
                                        const PartitionOptions& options, SearchCost& cost);

// Of all particles. The guide has no splitters; under a cut tolerance it doesn't depend on how the particles are
// distributed.
struct SmallSet {
  Guide guide;
  std::uint64_t count = 0;
  geometry::Box box;         // exact
  particles::Range weights;  // empty: there are none
};

// Collective (one gather; under a cut tolerance one sum, too).
SmallSet look_at_small_set(comm::Comm& comm, const particles::ParticleView& particles, const PartitionOptions& options,
                           SearchCost& cost);

}  // namespace rcb::partition
