// Policy: decides when a step repartitions, and says why in words.
//
// `tolerance` compares the error with a tolerance. `cost` compares the time lost by the error with the time of a
// repartition: of the step times that the solver reports, the share 1 - best / imbalance was spent waiting for the most
// loaded part, and new cuts are searched once the sum of these losses since the last repartition, and of what the step
// to come would lose under its imbalance, exceeds the time of a repartition. If the loss per step grows steadily, this
// is the best interval possible; however it develops, the total cost is at most about twice the least possible.
// Sources: Nicol and Saltz 1988, doi:10.1109/12.2131; Menon and others 2012, doi:10.1109/CLUSTER.2012.61.
//
// Invariants
// 1. No clock is read here: a decision follows from its input. Rank 0 keeps the account, and an order tells all ranks
//    what a decision needs of it (DecisionTerms), so they decide alike.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <string_view>

#include "common/partition/balance/load.hpp"
#include "common/wire/message.hpp"
#include "server/scene/options.hpp"

namespace rcb::scene {

// The time that imbalance has cost since the last repartition, and the time that repartitions take.
class CostAccount {
 public:
  static constexpr std::size_t kRemembered = 5;  // repartitions whose times are kept

  // Restarts the sum: new cuts are in force, or a search found none better. imbalance: max(load / target) of the cuts
  // now in force, the best that can be expected.
  void start_again(double imbalance);
  // The step of a repartition and its seconds, the same on every rank. The seconds of the first partition, which starts
  // from nothing and moves every particle, are used only until there are others.
  void repartitioned(std::int64_t step, double seconds, bool first);
  // The solver computed for `seconds` under this imbalance.
  void computed(double seconds, double imbalance);

  double lost_seconds() const { return lost_seconds_; }
  double lost_seconds_with(double seconds, double imbalance) const;  // after computed(); finite
  double repartition_seconds() const;                                // median of the last kRemembered
  double best_imbalance() const { return best_imbalance_; }
  wire::Json to_json() const;
  static CostAccount from_json(const wire::Json& json);  // throws std::exception where it can't be to_json()'s
  std::optional<std::int64_t> since() const { return since_; }

 private:
  double best_imbalance_ = 1;
  double lost_seconds_ = 0;
  std::optional<std::int64_t> since_;  // step of the last repartition; unset if the sum was restarted otherwise
  std::optional<double> first_seconds_;
  std::deque<double> seconds_;  // of the last kRemembered repartitions
};

// What a decision needs beside the loads of the step: the state of rank 0's account.
struct DecisionTerms {
  std::optional<double> error_when_not_adopted;  // error_before of the last wasted search
  bool timed = false;                            // the policy is cost, and the solver reported this step's seconds
  double lost_seconds = 0;
  double repartition_seconds = 0;
  double balanced_seconds = 0;  // of the step before, had each part had its target: its seconds / its imbalance
  double best_imbalance = 1;    // that can be expected of new cuts
  std::optional<std::int64_t> since{};
};

wire::Json to_json(const DecisionTerms& terms);
// A finite number that isn't below 0. Throws where it is none.
double finite_from(const wire::Json& json);
// Of an order, which rank 0 has made: trusted.
DecisionTerms read_terms(const wire::Json& json);

struct Decision {
  bool search = false;  // look for new cuts
  std::string reason;
};

struct PolicyInput : DecisionTerms {
  double error_before = 0;
  double imbalance = 1;        // of the step to come, under the cuts in force
  double tolerance = 0.1;      // may be infinity
  bool may_be_wasted = false;  // new cuts might fail to lower the error (weights, inexact cuts)
  double quota_error = 0;      // without weights: the error that quotas of whole particles leave
  Policy policy = Policy::tolerance;
};

Decision decide(const PolicyInput& input);
// Whether a step with these loads, before which there were particles, searches new cuts.
Decision decide_step(const SceneOptions& options, const partition::LoadSummary& loads, const DecisionTerms& terms);
// True if new cuts may turn out not to lower the error.
bool may_be_wasted(const SceneOptions& options, const partition::LoadSummary& loads);

// The final reason, after a search. If may_be_wasted, new cuts are adopted only if they lower the error.
std::string reason_adopted(const Decision& decision, double error_after);
std::string reason_not_adopted(const Decision& decision, double error_after);

}  // namespace rcb::scene
