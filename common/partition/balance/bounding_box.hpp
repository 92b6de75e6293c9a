// The extents of all ranks' particles.
#pragma once

#include <cstdint>
#include <span>

#include "common/comm/comm.hpp"
#include "common/geometry/box.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::partition {

// The box of all ranks' particles; empty if there are none. Collective (one reduction).
geometry::Box bounding_box(comm::Comm& comm, const particles::ParticleView& particles);

// Extends each box so that it holds that of every rank. Collective (one reduction).
//   more  becomes the least values of all ranks in the same reduction
void extend_by_all(comm::Comm& comm, std::span<geometry::Box> boxes, int dims, std::span<std::uint64_t> more = {});

}  // namespace rcb::partition
