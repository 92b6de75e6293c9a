// The maps from coordinates to integers against their plain meaning, also for coordinates beyond the range that they
// were made for.
#include "common/partition/points/axis_map.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include <gtest/gtest.h>

#include "common/base/random.hpp"

namespace rcb::partition {
namespace {

using Limits = std::numeric_limits<double>;
constexpr std::uint64_t kAxisMapSeed = 20261121;

// Ascending.
std::vector<std::vector<double>> hostile_sets() {
  Random random(kAxisMapSeed);
  std::vector<std::vector<double>> sets(11);
  for (int i = 0; i < 500; ++i) {
    sets[0].push_back(random.uniform());
    sets[1].push_back(1e12 + random.uniform(0, 1e-3));
    sets[2].push_back((random.below(2) == 0 ? -1 : 1) * std::pow(10.0, random.uniform(-300, 300)));
    sets[3].push_back(static_cast<double>(random.below(20)) - 9);
    sets[4].push_back(static_cast<double>(random.below(9)) * Limits::denorm_min());
    sets[5].push_back(random.below(2) == 0 ? Limits::max() : Limits::lowest());
    sets[6].push_back(-2.5);
    sets[7].push_back(1 + static_cast<double>(random.below(7)) * Limits::epsilon());
    sets[8].push_back(1e308 * random.uniform(-1, 1));
    sets[9].push_back(random.below(2) == 0 ? 0.0 : -0.0);
    sets[10].push_back(std::pow(10.0, random.uniform(-6, 6)));
  }
  for (auto& set : sets) std::ranges::sort(set);
  return sets;
}

// Against each pair of neighbours; and the range's end where there is none.
void check_map(const AxisMap& map, const std::vector<double>& set) {
  SCOPED_TRACE(::testing::Message() << "of " << set.front() << " to " << set.back() << (map.linear() ? " linear" : ""));
  std::int32_t last = 0;
  for (const double x : set) {
    const std::int32_t q = map(x);
    EXPECT_GE(q, last);
    EXPECT_LE(q, AxisMap::kTop);
    EXPECT_LE(map.least(q), x);
    EXPECT_GE(map.most(q), x);
    EXPECT_GE(map.least(q), set.front());
    EXPECT_LE(map.most(q), set.back());
    if (map.lossless() && !map.linear()) {
      EXPECT_EQ(map.value(q), x);
    }
    const double first = map.first_value(q);
    EXPECT_LE(first, x);
    EXPECT_GE(first, set.front());
    EXPECT_EQ(map(first), q);
    if (first > set.front()) {
      EXPECT_LT(map(std::nextafter(first, Limits::lowest())), q);
    }
    last = q;
  }
  EXPECT_EQ(map(-0.0), map(0.0));
}

TEST(AxisMap, RisesWithTheCoordinateAndKnowsItsBounds) {
  for (const std::vector<double>& set : hostile_sets())
    for (AxisMap map : {AxisMap::by_value(set.front(), set.back()), AxisMap::by_order_bits(set.front(), set.back())}) {
      map.set_range(set.front(), set.back());
      check_map(map, set);
    }
}

TEST(AxisMap, IsRightForCoordinatesBeyondItsRange) {
  Random random(kAxisMapSeed);
  const std::vector<std::vector<double>> sets = hostile_sets();
  int clamped = 0;
  for (int round = 0; round < 400; ++round) {
    const std::vector<double>& set = sets[random.below(sets.size())];
    std::size_t first = random.below(set.size());
    std::size_t last = random.below(set.size());
    if (first > last) std::swap(first, last);
    const std::span sample = std::span(set).subspan(first, last - first + 1);
    for (AxisMap map : {AxisMap::by_value(set[first], set[last]), AxisMap::by_order_bits(set[first], set[last]),
                        plan_sampled_axis(set[first], set[last], sample).map()}) {
      map.set_range(set.front(), set.back());
      check_map(map, set);
      clamped += map(set.front()) == 0 && map.least(0) < map.value(0) ? 1 : 0;
    }
    const std::vector<double>& other = sets[random.below(sets.size())];
    std::vector<double> all(set);
    all.insert(all.end(), other.begin(), other.end());
    std::ranges::sort(all);
    AxisMap map = plan_sampled_axis(set[first], set[last], sample).map();
    map.set_range(all.front(), all.back());
    check_map(map, all);
  }
  EXPECT_GT(clamped, 100);
}

TEST(AxisMap, LatticesAreTold) {
  const std::vector<double> x{-3, -2.5, 0, 4.5, 100};
  const auto shared_zeros = [&](const AxisMap& map) {
    Lossless lossless;
    for (const double value : x) lossless.look(0, value, map.value(map(value)), map(value));
    return lossless.zeros(0);
  };
  const AxisPlan exact = plan_axis(x.front(), x.back(), x);
  EXPECT_TRUE(exact.maybe_lossless);
  AxisMap map = exact.map();
  ASSERT_GT(shared_zeros(map), 20);
  map.set_lossless(static_cast<unsigned>(shared_zeros(map)));
  EXPECT_EQ(map(-3.0), 0);
  EXPECT_EQ(map(-2.5) >> map.zeros(), 1);
  for (const double value : x) {
    EXPECT_EQ(map.value(map(value)), value);
    EXPECT_EQ(map.least(map(value)), value);
    EXPECT_EQ(map.most(map(value)), value);
  }
  // With a wider range, too.
  const AxisPlan wider = plan_sampled_axis(x.front(), x.back(), x);
  EXPECT_TRUE(wider.maybe_lossless);
  EXPECT_LE(wider.lo, -3 - 103.0 / 2);
  EXPECT_GE(wider.lo, -3 - 103.0);
  EXPECT_EQ(wider.hi, 100 + 103.0 / 2);
  EXPECT_GT(shared_zeros(wider.map()), 20);

  const std::vector<double> other{-3, 0.1, 100};
  EXPECT_FALSE(plan_axis(-3, 100, other).maybe_lossless);
  EXPECT_FALSE(plan_sampled_axis(-3, 100, other).maybe_lossless);
}

TEST(AxisMap, ManyDecadesAreMappedByOrderBits) {
  const std::vector<std::vector<double>> sets = hostile_sets();
  EXPECT_TRUE(plan_sampled_axis(sets[10].front(), sets[10].back(), sets[10]).by_order_bits);
  EXPECT_TRUE(plan_sampled_axis(sets[2].front(), sets[2].back(), sets[2]).by_order_bits);
  EXPECT_FALSE(plan_sampled_axis(sets[0].front(), sets[0].back(), sets[0]).by_order_bits);
  EXPECT_FALSE(plan_sampled_axis(sets[8].front(), sets[8].back(), sets[8]).by_order_bits);
}

TEST(AxisMap, APlaneLosesNothingUntilAParticleLiesBeyondIt) {
  const std::vector<double> plane(9, -2.5);
  AxisMap map = plan_sampled_axis(-2.5, -2.5, plane).map();
  EXPECT_TRUE(map.lossless());
  map.set_range(-2.5, -2.5);
  EXPECT_TRUE(map.lossless());
  EXPECT_LT(map(-3), map(-2.5));
  EXPECT_LT(map(-2.5), map(0));
  map.set_range(-2.5, 7);
  EXPECT_FALSE(map.lossless());
  EXPECT_EQ(map.most(map(7)), 7);
}

}  // namespace
}  // namespace rcb::partition
