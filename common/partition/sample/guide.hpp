// Guide: what all ranks know before the pass over their particles: where the upper cuts are expected, and how
// coordinates become integers. Here for a set of which no cuts are known.
#pragma once

#include <array>
#include <cstdint>

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

}  // namespace rcb::partition
