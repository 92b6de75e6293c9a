// Policy: when a step repartitions, and why, in words. Local and free of state, so that every rank says the same.
#pragma once

#include <optional>
#include <string>

namespace rcb::service {

struct Decision {
  bool search = false;  // look for new cuts
  std::string reason;
};

struct PolicyInput {
  double error_before = 0;
  double tolerance = 0.1;  // may be infinity
  bool weighted = false;
  double quota_error = 0;                        // without weights: the error that a partition ends with
  std::optional<double> error_when_not_adopted;  // with weights: error_before of the last vain attempt
};

Decision decide(const PolicyInput& input);

// With weights new cuts are adopted only if they lower the error. Returns the final reason.
std::string reason_adopted(const Decision& decision, double error_after);
std::string reason_not_adopted(double error_before, double tolerance, double error_after);

}  // namespace rcb::service
