// When a step repartitions: the decision as a function of its input, and the account of what imbalance has cost.
#include "server/scene/policy.hpp"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

namespace rcb::scene {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

PolicyInput by_cost(double lost, double repartition) {
  PolicyInput input;
  input.error_before = 0.3;
  input.policy = Policy::cost;
  input.timed = true;
  input.lost_seconds = lost;
  input.repartition_seconds = repartition;
  input.since = 40;
  return input;
}

TEST(Policy, ToleranceIsReached) {
  PolicyInput input;
  input.tolerance = 0.25;
  input.error_before = 0.249;
  EXPECT_FALSE(decide(input).search);
  EXPECT_EQ(decide(input).reason, "error 0.249 is below the tolerance 0.25");
  input.error_before = 0.25;
  EXPECT_TRUE(decide(input).search);
  EXPECT_EQ(decide(input).reason, "error 0.25 has reached the tolerance 0.25");
  input.tolerance = kInfinity;
  EXPECT_FALSE(decide(input).search);
}

TEST(Policy, CostMustBeExceeded) {
  EXPECT_FALSE(decide(by_cost(0.009, 0.009)).search);
  const Decision decision = decide(by_cost(0.012, 0.009));
  EXPECT_TRUE(decision.search);
  EXPECT_EQ(decision.reason,
            "error 0.3; imbalance has cost 0.012 s since step 40 and would cost 0 s in this one, a repartition costs "
            "0.009 s");
}

TEST(Policy, CostLooksAStepAhead) {
  PolicyInput input = by_cost(0.005, 0.009);
  input.balanced_seconds = 0.01;
  input.imbalance = 1.5;
  EXPECT_TRUE(decide(input).search);  // 0.005 s more
  input.best_imbalance = 1.2;         // 0.003 s
  EXPECT_FALSE(decide(input).search);
  input.best_imbalance = 1.6;  // better than can be expected
  EXPECT_NE(decide(input).reason.find("would cost 0 s"), std::string::npos);
  input.balanced_seconds = std::numeric_limits<double>::max();
  input.best_imbalance = 1;
  input.imbalance = 1e9;
  EXPECT_TRUE(decide(input).search);
}

TEST(Policy, ToleranceHasNoSayInCost) {
  PolicyInput input = by_cost(0.012, 0.009);
  input.tolerance = kInfinity;
  EXPECT_TRUE(decide(input).search);
  input = by_cost(0.001, 0.009);
  input.tolerance = 0;
  EXPECT_FALSE(decide(input).search);
}

TEST(Policy, WithoutAStepTimeTheToleranceDecides) {
  PolicyInput input = by_cost(0.012, 0.009);
  input.timed = false;
  input.tolerance = 0.5;
  EXPECT_FALSE(decide(input).search);
  EXPECT_EQ(decide(input).reason, "no step time was told: error 0.3 is below the tolerance 0.5");
  input.tolerance = 0.2;
  EXPECT_TRUE(decide(input).search);
}

TEST(Policy, NoSearchThatCanNotHelp) {
  for (const Policy policy : {Policy::tolerance, Policy::cost}) {
    PolicyInput input = by_cost(0.012, 0.009);
    input.policy = policy;
    input.quota_error = 0.3;
    EXPECT_FALSE(decide(input).search);
    input.quota_error = 0.29;
    EXPECT_TRUE(decide(input).search);
    input.may_be_wasted = true;
    input.error_when_not_adopted = 0.3;
    EXPECT_FALSE(decide(input).search);
    input.error_when_not_adopted = 0.29;
    EXPECT_TRUE(decide(input).search);
  }
}

// A loss that grows by a every step: the least of (a k^2 / 2 + C) / k is at k = sqrt(2 C / a).
TEST(CostAccount, SteadyGrowthIsCutAtTheBestInterval) {
  constexpr double kGrowth = 1e-3;
  constexpr double kCost = 0.8;
  CostAccount account;
  account.start_again(1);
  account.repartitioned(0, kCost, true);
  int step = 0;
  while (account.lost_seconds() <= account.repartition_seconds()) account.computed(1, 1 / (1 - kGrowth * ++step));
  EXPECT_EQ(step, std::lround(std::sqrt(2 * kCost / kGrowth)));
}

TEST(CostAccount, OnlyWhatARepartitionWouldSaveIsLost) {
  CostAccount account;
  account.start_again(1.25);  // no partition is better
  account.computed(8, 1.25);
  account.computed(8, 1.1);
  EXPECT_EQ(account.lost_seconds(), 0);
  account.computed(8, 2.5);
  EXPECT_EQ(account.lost_seconds(), 4);
  account.start_again(1);
  EXPECT_EQ(account.lost_seconds(), 0);
  account.computed(8, 2);
  EXPECT_EQ(account.lost_seconds(), 4);
}

TEST(CostAccount, ARepartitionCostsTheMedianOfTheLast) {
  CostAccount account;
  EXPECT_EQ(account.repartition_seconds(), 0);
  account.repartitioned(0, 9, true);
  EXPECT_EQ(account.repartition_seconds(), 9);
  account.repartitioned(3, 1, false);
  EXPECT_EQ(account.repartition_seconds(), 1) << "the first partition is forgotten";
  account.repartitioned(5, 2, false);
  EXPECT_EQ(account.repartition_seconds(), 1.5);
  account.repartitioned(6, 1000, false);
  EXPECT_EQ(account.repartition_seconds(), 2) << "one that took long is no rule";
  EXPECT_EQ(account.since(), 6);
  for (int k = 0; k < 5; ++k) account.repartitioned(7 + k, 4, false);
  EXPECT_EQ(account.repartition_seconds(), 4);
}

}  // namespace
}  // namespace rcb::scene
