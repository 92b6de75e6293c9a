#include "server/scene/policy.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <vector>

#include <fmt/format.h>

namespace rcb::scene {
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
  const double ahead = std::min(input.balanced_seconds * std::max(input.imbalance - input.best_imbalance, 0.0),
                                std::numeric_limits<double>::max());
  return {input.lost_seconds + ahead > input.repartition_seconds,
          fmt::format("error {:.6g}; imbalance has cost {:.3g} s since {} and would cost {:.3g} s in this one, a "
                      "repartition costs {:.3g} s",
                      input.error_before, input.lost_seconds, since, ahead, input.repartition_seconds)};
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

std::string_view travel_name(Travel travel) { return travel == Travel::when_needed ? "when-needed" : "every-step"; }

std::optional<Travel> travel_from_name(std::string_view name) {
  for (const Travel travel : {Travel::every_step, Travel::when_needed})
    if (name == travel_name(travel)) return travel;
  return std::nullopt;
}

wire::Json to_json(const DecisionTerms& terms) {
  wire::Json json = wire::Json::object();
  if (terms.error_when_not_adopted) json["error_when_not_adopted"] = *terms.error_when_not_adopted;
  if (terms.timed)
    json.update({{"lost", terms.lost_seconds},
                 {"repartition", terms.repartition_seconds},
                 {"balanced", terms.balanced_seconds},
                 {"best", terms.best_imbalance}});
  if (terms.since) json["since"] = *terms.since;
  return json;
}

DecisionTerms read_terms(const wire::Json& json) {
  DecisionTerms terms;
  if (json.contains("error_when_not_adopted"))
    terms.error_when_not_adopted = json["error_when_not_adopted"].get<double>();
  terms.timed = json.contains("lost");
  terms.lost_seconds = json.value("lost", 0.0);
  terms.repartition_seconds = json.value("repartition", 0.0);
  terms.balanced_seconds = json.value("balanced", 0.0);
  terms.best_imbalance = json.value("best", 1.0);
  if (json.contains("since")) terms.since = json["since"].get<std::int64_t>();
  return terms;
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

void CostAccount::computed(double seconds, double imbalance) { lost_seconds_ = lost_seconds_with(seconds, imbalance); }

double CostAccount::lost_seconds_with(double seconds, double imbalance) const {
  if (imbalance <= best_imbalance_) return lost_seconds_;
  return std::min(lost_seconds_ + seconds * (1 - best_imbalance_ / imbalance), std::numeric_limits<double>::max());
}

double CostAccount::repartition_seconds() const {
  return seconds_.empty() ? first_seconds_.value_or(0) : median({seconds_.begin(), seconds_.end()});
}

wire::Json CostAccount::to_json() const {
  wire::Json json = wire::Json::object();
  json["best"] = best_imbalance_;
  json["lost"] = lost_seconds_;
  json["since"] = wire::or_null(since_);
  json["first"] = wire::or_null(first_seconds_);
  json["seconds"] = std::vector<double>(seconds_.begin(), seconds_.end());
  return json;
}

double finite_from(const wire::Json& json) {
  const auto value = json.get<double>();
  if (!std::isfinite(value) || value < 0) throw std::out_of_range("a number that isn't finite, or below 0");
  return value;
}

CostAccount CostAccount::from_json(const wire::Json& json) {
  CostAccount account;
  account.best_imbalance_ = finite_from(json.at("best"));
  account.lost_seconds_ = finite_from(json.at("lost"));
  if (const wire::Json& since = json.at("since"); !since.is_null()) {
    if (!since.is_number_integer()) throw std::out_of_range("a step that isn't a whole number");
    account.since_ = since.get<std::int64_t>();
  }
  if (!json.at("first").is_null()) account.first_seconds_ = finite_from(json["first"]);
  for (const wire::Json& seconds : json.at("seconds").get_ref<const wire::Json::array_t&>())
    account.seconds_.push_back(finite_from(seconds));
  if (account.seconds_.size() > kRemembered) throw std::out_of_range("more repartitions than are kept");
  return account;
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

bool may_be_wasted(const SceneOptions& options, const partition::LoadSummary& loads) {
  return loads.weighted || options.cut_tolerance > 0;
}

Decision decide_step(const SceneOptions& options, const partition::LoadSummary& loads, const DecisionTerms& terms) {
  PolicyInput input;
  static_cast<DecisionTerms&>(input) = terms;
  input.error_before = loads.error;
  input.imbalance = loads.imbalance;
  input.tolerance = options.tolerance;
  input.may_be_wasted = may_be_wasted(options, loads);
  input.policy = options.policy;
  if (!input.may_be_wasted && (input.timed || input.error_before >= options.tolerance)) {
    const auto n = std::accumulate(loads.counts.begin(), loads.counts.end(), std::uint64_t{0});
    input.quota_error =
        partition::summarise_counts(partition::quotas(n, options.part_sizes, options.parts), options.part_sizes).error;
  }
  return decide(input);
}

std::string reason_adopted(const Decision& decision, double error_after) {
  return fmt::format("{}; new cuts leave {:.6g}", decision.reason, error_after);
}

std::string reason_not_adopted(const Decision& decision, double error_after) {
  return fmt::format("{}, but new cuts would leave {:.6g}: not adopted", decision.reason, error_after);
}

}  // namespace rcb::scene
