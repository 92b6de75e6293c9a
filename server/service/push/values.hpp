// Whether positions, weights and ids are values that a scene takes: positions and weights are finite, weights >= 0 and
// ids >= 0.
#pragma once

#include <cstddef>

#include "common/base/status.hpp"
#include "common/comm/comm.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::service {

// Local.
bool bad_weights(const double* weight, std::size_t count);
bool has_fault(const particles::ParticleView& view);

// What is wrong where some rank has a fault; names the offender with the smallest id. has_ids: ids were given; else
// they are rows. Collective.
Status fault_in(comm::Comm& comm, const particles::ParticleView& view, bool has_ids);

}  // namespace rcb::service
