#include "server/service/policy.hpp"

#include <cmath>

#include <fmt/format.h>

namespace rcb::service {

Decision decide(const PolicyInput& input) {
  if (std::isinf(input.tolerance))
    return {false, fmt::format("error {:.6g}; tolerance inf forbids repartitions", input.error_before)};
  if (!(input.error_before >= input.tolerance))
    return {false, fmt::format("error {:.6g} is below the tolerance {:.6g}", input.error_before, input.tolerance)};
  const std::string reached =
      fmt::format("error {:.6g} has reached the tolerance {:.6g}", input.error_before, input.tolerance);
  if (!input.weighted && input.error_before <= input.quota_error)
    return {false, fmt::format("{}, but no partition is better: whole particles leave an error of {:.6g}", reached,
                               input.quota_error)};
  if (input.weighted && input.error_when_not_adopted && input.error_before <= *input.error_when_not_adopted)
    return {false, fmt::format("{}, but new cuts did not lower it at {:.6g} and it hasn't grown since", reached,
                               *input.error_when_not_adopted)};
  return {true, reached};
}

std::string reason_adopted(const Decision& decision, double error_after) {
  return fmt::format("{}; new cuts leave {:.6g}", decision.reason, error_after);
}

std::string reason_not_adopted(double error_before, double tolerance, double error_after) {
  return fmt::format("error {:.6g} has reached the tolerance {:.6g}, but new cuts would leave {:.6g}: not adopted",
                     error_before, tolerance, error_after);
}

}  // namespace rcb::service
