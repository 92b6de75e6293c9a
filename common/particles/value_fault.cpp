#include "common/particles/value_fault.hpp"

#include <cmath>

#include <fmt/format.h>

#include "common/base/axis_names.hpp"

namespace rcb::particles {

std::optional<ValueFault> fault_of(const geometry::Point& x, int dims, double weight, Id id) {
  for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a)
    if (!std::isfinite(x[a]))
      return ValueFault{0, Code::not_finite, fmt::format("{} is {}", kAxisNames[a], x[a]),
                        "positions must be finite; nothing was changed"};
  if (!(weight >= 0 && std::isfinite(weight)))
    return ValueFault{0, std::isfinite(weight) ? Code::invalid_argument : Code::not_finite,
                      fmt::format("weight is {}", weight), "weights must be finite and >= 0; nothing was changed"};
  if (id < 0)
    return ValueFault{0, Code::invalid_argument, fmt::format("id is {}", id), "ids must be >= 0; nothing was changed"};
  return std::nullopt;
}

}  // namespace rcb::particles
