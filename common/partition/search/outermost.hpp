// Outermost particles: those that lie beyond the sampled ones. Where the extents of the root hardly differ, as in a
// cube, these few decide which is the longest, and hence how all particles are divided.
#pragma once

#include <cstdint>
#include <vector>

#include "common/comm/comm.hpp"
#include "common/geometry/box.hpp"
#include "common/particles/particle_set.hpp"
#include "common/partition/search/request.hpp"
#include "common/partition/search/sorted_sample.hpp"

namespace rcb::partition {

// Whether particles beyond the sampled ones may change the order of the root's axes.
struct OpenOrder {
  bool first = false;   // which axis is the longest
  bool others = false;  // in which order the others follow
};

// axes: in the order of the sampled extents. Local.
OpenOrder open_order(const SortedSample& sample, const AxisOrder& axes, double overhang);

// Gives a sample all particles that lie outside of all these boxes; false if they are likely to be too many. Adds what
// it costs to `spent`. Collective (at most one gather). Reads every position once.
//   boxes   of its particles on either side of the root's expected cut; the same on all ranks
//   stride  one particle of so many was sampled
bool gather_outermost(comm::Comm& comm, const particles::ParticleView& particles, std::span<const geometry::Box> boxes,
                      std::uint64_t stride, SortedSample& sample, PartitionResult& spent);

// The same where the sample leaves the longest axis open, unless that is done already. Collective (at most two
// gathers).
void gather_outermost_if_open(comm::Comm& comm, const particles::ParticleView& particles,
                              const PartitionOptions& options, std::uint64_t stride, SortedSample& sample,
                              PartitionResult& spent);

}  // namespace rcb::partition
