// Outermost particles: those that lie beyond the sampled ones. Where the extents of the root hardly differ, as in a
// cube, these few decide which is the longest, and hence how all particles are divided.
#pragma once

#include <cstdint>

#include "common/comm/comm.hpp"
#include "common/particles/particle_set.hpp"
#include "common/partition/rules/request.hpp"
#include "common/partition/sample/sorted_sample.hpp"

namespace rcb::partition {

// Where a sample leaves the root's longest axis open, gives it all particles that lie outside of the boxes of its
// particles on either side of the root's expected cut, unless these are likely to be too many. Adds what it costs to
// `cost`. Collective (at most two gathers). Reads every position once.
//   stride  one particle of so many was sampled
void gather_outermost_if_open(comm::Comm& comm, const particles::ParticleView& particles,
                              const PartitionOptions& options, std::uint64_t stride, SortedSample& sample,
                              SearchCost& cost);

}  // namespace rcb::partition
