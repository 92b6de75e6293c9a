// Pauses that grow, with a share of chance.
#include "common/base/backoff.hpp"

#include <random>
#include <set>
#include <string>

#include <gtest/gtest.h>

namespace rcb {
namespace {

TEST(Backoff, FirstAtOnceThenTwiceAsLongEachTimeWithAShareByChance) {
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  Backoff backoff({.first_seconds = 0.05, .most_seconds = 2, .shortened = 0.5, .at_once = true}, seed);
  EXPECT_EQ(backoff.next(), 0);
  double longest = 0.05;
  bool differs = false;
  for (int k = 0; k < 20; ++k) {
    const double wait = backoff.next();
    EXPECT_GE(wait, longest / 2);
    EXPECT_LE(wait, longest);
    differs = differs || wait != longest;
    longest = std::min(2 * longest, 2.0);
  }
  EXPECT_TRUE(differs);
}

TEST(Backoff, GrowsToItsCapAndNeverGivesUp) {
  constexpr std::uint64_t kSeed = 7;
  RecordProperty("seed", static_cast<int>(kSeed));
  Backoff backoff({.first_seconds = 0.5, .most_seconds = 30, .shortened = 0.25}, kSeed);
  double wanted = 0.5;
  std::set<double> pauses;
  for (int failure = 1; failure <= 1000; ++failure) {
    const double pause = backoff.next();
    ASSERT_GE(pause, 0.75 * wanted) << failure;
    ASSERT_LE(pause, wanted) << failure;
    ASSERT_EQ(backoff.failures(), failure);
    pauses.insert(pause);
    wanted = std::min(2 * wanted, 30.0);
  }
  EXPECT_GT(pauses.size(), 900U) << "no two services pause alike";
  backoff.reset();
  EXPECT_LE(backoff.next(), 0.5);
  EXPECT_EQ(backoff.failures(), 1);
}

}  // namespace
}  // namespace rcb
