#include "server/service/scene/policy.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include <fmt/format.h>

namespace rcb::service {
namespace {

// Whether the policy asks for new cuts, before decide() checks whether they can help.
Decision asked_by_tolerance(const PolicyInput& input) {
  if (std::isinf(input.tolerance))
    return {false, fmt::format("error {:.6g}; tolerance inf forbids repartitions", input.error_before)};
  if (!(input.error_before >= input.tolerance))
    return {false, fmt::format("error {:.6g} is below the tolerance {:.6g}", input.error_before, input.tolerance)};
  return {true, fmt::format("error {:.6g} has reached the tolerance {:.6g}", input.error_before, input.tolerance)};
}

Decision asked_by_cost(const PolicyInput& input) {
  const std::string since = input.since ? fmt::format("step {}", *input.since) : "the last repartition";
  return {input.lost_seconds > input.repartition_seconds,
          fmt::format("error {:.6g}; imbalance has cost {:.3g} s since {}, a repartition costs {:.3g} s",
                      input.error_before, input.lost_seconds, since, input.repartition_seconds)};
}

Decision asked(const PolicyInput& input) {
  if (input.policy == Policy::tolerance) return asked_by_tolerance(input);
  if (input.timed) return asked_by_cost(input);
  Decision decision = asked_by_tolerance(input);
  decision.reason = "no step time was told: " + decision.reason;
  return decision;
}

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  const std::size_t half = values.size() / 2;
  return values.size() % 2 == 1 ? values[half] : (values[half - 1] + values[half]) / 2;
}

}  // namespace

std::string_view policy_name(Policy policy) { return policy == Policy::cost ? "cost" : "tolerance"; }

std::optional<Policy> policy_from_name(std::string_view name) {
  for (const Policy policy : {Policy::tolerance, Policy::cost})
    if (name == policy_name(policy)) return policy;
  return std::nullopt;
}

void CostAccount::start_again(double imbalance) {
  best_imbalance_ = imbalance;
  lost_seconds_ = 0;
  since_.reset();
}

void CostAccount::repartitioned(std::int64_t step, double seconds, bool first) {
  since_ = step;
  if (first) {
    first_seconds_ = seconds;
    return;
  }
  seconds_.push_back(seconds);
  if (seconds_.size() > kRemembered) seconds_.pop_front();
}

void CostAccount::computed(double seconds, double imbalance) {
  if (imbalance > best_imbalance_) lost_seconds_ += seconds * (1 - best_imbalance_ / imbalance);
}

double CostAccount::repartition_seconds() const {
  return seconds_.empty() ? first_seconds_.value_or(0) : median({seconds_.begin(), seconds_.end()});
}

Decision decide(const PolicyInput& input) {
  Decision decision = asked(input);
  if (!decision.search) return decision;
  if (!input.may_be_wasted && input.error_before <= input.quota_error)
    return {false, fmt::format("{}, but no partition is better: whole particles leave an error of {:.6g}",
                               decision.reason, input.quota_error)};
  if (input.may_be_wasted && input.error_when_not_adopted && input.error_before <= *input.error_when_not_adopted)
    return {false, fmt::format("{}, but new cuts did not lower it at {:.6g} and it hasn't grown since", decision.reason,
                               *input.error_when_not_adopted)};
  return decision;
}

std::string reason_adopted(const Decision& decision, double error_after) {
  return fmt::format("{}; new cuts leave {:.6g}", decision.reason, error_after);
}

std::string reason_not_adopted(const Decision& decision, double error_after) {
  return fmt::format("{}, but new cuts would leave {:.6g}: not adopted", decision.reason, error_after);
}

}  // namespace rcb::service
