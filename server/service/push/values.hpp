// Whether positions, weights and ids are values that a scene takes.
#pragma once

#include <cstdint>
#include <optional>

#include "common/base/status.hpp"
#include "common/comm/comm.hpp"
#include "common/particles/value_fault.hpp"

namespace rcb::service {

using particles::kGoodValues;
using particles::ValueFault;

// The fault of the first particle that has one. Local.
std::optional<ValueFault> first_fault(const particles::ParticleView& view);

// Collective. Checks that positions and weights are finite, weights >= 0 and ids >= 0. The error names the offender
// with the smallest id. has_ids: ids were given; else they are rows.
Status check_values(comm::Comm& comm, const particles::ParticleView& view, bool has_ids);

}  // namespace rcb::service
