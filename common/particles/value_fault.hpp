// Which values of a particle a scene takes, and what is said of others.
#pragma once

#include <optional>
#include <string>

#include "common/base/status.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::particles {

// A coordinate, weight or id that a scene doesn't take.
struct ValueFault {
  std::size_t particle = 0;            // its place, for those who look through many
  Code code = Code::invalid_argument;  // or not_finite
  std::string text;                    // "x is nan"
  const char* rule = "";               // that is broken: a hint
};

std::optional<ValueFault> fault_of(const geometry::Point& x, int dims, double weight, Id id);

}  // namespace rcb::particles
