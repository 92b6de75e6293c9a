// Whether positions, weights and ids are values that a scene takes.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "common/base/status.hpp"
#include "common/comm/comm.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::service {

// A particle's coordinate, weight or id that a scene doesn't take.
struct ValueFault {
  std::size_t particle = 0;
  Code code = Code::invalid_argument;  // or not_finite
  std::string text;                    // "x is nan"
};
inline constexpr const char* kGoodValues =
    "positions must be finite, weights finite and >= 0, ids >= 0; the previous step stands";

// The fault of the first particle that has one. Local.
std::optional<ValueFault> first_fault(const particles::ParticleView& view);

// Collective. Checks that positions and weights are finite, weights >= 0 and ids >= 0. The error names the first
// offender: at a first push by its row (`first_row` is this rank's first row), later by its id.
Status check_values(comm::Comm& comm, const particles::ParticleView& view, bool first, std::uint64_t first_row);

}  // namespace rcb::service
