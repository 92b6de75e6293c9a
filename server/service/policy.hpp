// Policy: when a step repartitions, and why, in words.
//
// `tolerance` asks how large the error is; `cost` asks what it has cost: the solver tells the seconds of its steps, of
// which a share of 1 - best / imbalance was spent waiting for the most loaded part. New cuts are looked for once the
// sum of that since the last repartition exceeds what a repartition takes. Where the loss grows steadily this is the
// best interval there is, and on any other course of it the loss is at most about twice the least possible. Sources:
// Nicol and Saltz 1988, doi:10.1109/12.2131; Menon and others 2012, doi:10.1109/CLUSTER.2012.61.
//
// Invariants
// 1. Free of clocks: a decision follows from its input, so ranks that have the same input say the same.
// 2. What CostAccount holds is the same on all ranks: the seconds of a repartition are rank 0's, told to all.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <string_view>

namespace rcb::service {

enum class Policy { tolerance, cost };

std::string_view policy_name(Policy policy);
std::optional<Policy> policy_from_name(std::string_view name);

// What imbalance has cost since the last repartition, and what repartitions take.
class CostAccount {
 public:
  static constexpr std::size_t kRemembered = 5;  // repartitions

  // New cuts are in force, or a search found none better; imbalance: max(load / target), the best that can be expected.
  void start_again(double imbalance);
  // The step of that repartition and its seconds, the same on every rank. The first partition's count until there is
  // another, since it starts from nothing and moves every particle.
  void repartitioned(std::int64_t step, double seconds, bool first);
  // The solver computed for so long under this imbalance.
  void computed(double seconds, double imbalance);

  double lost_seconds() const { return lost_seconds_; }
  double repartition_seconds() const;  // median of the last few
  std::optional<std::int64_t> since() const { return since_; }

 private:
  double best_imbalance_ = 1;
  double lost_seconds_ = 0;
  std::optional<std::int64_t> since_;  // none: the cuts in force were asked for, not found at a step
  std::optional<double> first_seconds_;
  std::deque<double> seconds_;  // of the last repartitions
};

struct Decision {
  bool search = false;  // look for new cuts
  std::string reason;
};

struct PolicyInput {
  double error_before = 0;
  double tolerance = 0.1;                        // may be infinity
  bool may_be_vain = false;                      // weights, or cuts that aren't exact: new cuts may be no better
  double quota_error = 0;                        // without weights: the error that a partition ends with
  std::optional<double> error_when_not_adopted;  // with weights: error_before of the last vain attempt
  Policy policy = Policy::tolerance;
  bool timed = false;       // the solver told this step's seconds; else the tolerance decides
  double lost_seconds = 0;  // CostAccount's, where policy is cost
  double repartition_seconds = 0;
  std::optional<std::int64_t> since{};
};

Decision decide(const PolicyInput& input);

// With weights new cuts are adopted only if they lower the error. Returns the final reason.
std::string reason_adopted(const Decision& decision, double error_after);
std::string reason_not_adopted(const Decision& decision, double error_after);

}  // namespace rcb::service
