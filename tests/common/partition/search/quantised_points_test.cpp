// The maps from coordinates to integers, and the passes over records, against their plain meaning.
#include "common/partition/search/quantised_points.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <ranges>

#include <gtest/gtest.h>

#include "common/base/random.hpp"

namespace rcb::partition {
namespace {

using Limits = std::numeric_limits<double>;
constexpr std::uint64_t kMapSeed = 20261121;

std::vector<std::vector<double>> sets() {
  Random random(kMapSeed);
  std::vector<std::vector<double>> sets(8);
  for (int i = 0; i < 500; ++i) {
    sets[0].push_back(random.uniform());
    sets[1].push_back(1e12 + random.uniform(0, 1e-3));
    sets[2].push_back((random.below(2) == 0 ? -1 : 1) * std::pow(10.0, random.uniform(-300, 300)));
    sets[3].push_back(static_cast<double>(random.below(20)) - 9);
    sets[4].push_back(static_cast<double>(random.below(9)) * Limits::denorm_min());
    sets[5].push_back(random.below(2) == 0 ? Limits::max() : Limits::lowest());
    sets[6].push_back(-2.5);
    sets[7].push_back(1 + static_cast<double>(random.below(7)) * Limits::epsilon());
  }
  for (auto& set : sets) std::ranges::sort(set);
  return sets;
}

TEST(AxisMap, RisesWithTheCoordinateAndKnowsItsBounds) {
  for (const std::vector<double>& set : sets())
    for (const AxisMap& map :
         {AxisMap::by_value(set.front(), set.back()), AxisMap::by_order_bits(set.front(), set.back())}) {
      SCOPED_TRACE(::testing::Message() << "from " << set.front() << " to " << set.back()
                                        << (map.linear() ? " linear" : ""));
      std::int32_t last = 0;
      for (const double x : set) {
        const std::int32_t q = map(x);
        EXPECT_GE(q, last);
        EXPECT_LE(q, AxisMap::kTop);
        EXPECT_LE(map.least(q), x);
        EXPECT_GE(map.most(q), x);
        const double first = map.first_value(q);
        EXPECT_LE(first, x);
        EXPECT_EQ(map(first), q);
        if (first > set.front()) {
          EXPECT_LT(map(std::nextafter(first, Limits::lowest())), q);
        }
        last = q;
      }
      EXPECT_EQ(map(-0.0), set.front() <= 0 && set.back() >= 0 ? map(0.0) : map(-0.0));
    }
}

TEST(AxisMap, LatticesAreTold) {
  const std::vector<double> x{-3, -2.5, 0, 4.5, 100};
  AxisMap map = AxisMap::by_value(x.front(), x.back());
  const int zeros = zeros_of_lossless(map, x);
  ASSERT_GT(zeros, 0);
  map.set_lossless(static_cast<unsigned>(zeros));
  EXPECT_EQ(map(-3.0), 0);
  EXPECT_EQ(map(-2.5) >> map.zeros(), 1);
  for (const double value : x) EXPECT_EQ(map.value(map(value)), value);
  const std::vector<double> other{-3, 0.1, 100};
  EXPECT_EQ(zeros_of_lossless(AxisMap::by_value(-3, 100), other), -1);
}

std::vector<QuantisedPoint> random_points(Random& random, std::size_t count, std::int32_t range) {
  std::vector<QuantisedPoint> points(count);
  for (std::size_t i = 0; i < count; ++i) {
    for (std::int32_t& q : points[i].q) q = static_cast<std::int32_t>(random.below(static_cast<std::uint64_t>(range)));
    points[i].index = static_cast<std::uint32_t>(i);
  }
  return points;
}

TEST(QuantisedPoints, PassesDoWhatTheySay) {
  for (std::uint64_t seed = kMapSeed; seed < kMapSeed + 200; ++seed) {
    Random random(seed);
    SCOPED_TRACE("seed " + std::to_string(seed));
    const auto range = static_cast<std::int32_t>(1 + random.below(seed % 2 == 0 ? 5 : 1000));
    const std::vector<QuantisedPoint> before = random_points(random, random.below(60), range);
    const std::size_t axis = random.below(3);
    const auto at = static_cast<std::int32_t>(random.below(static_cast<std::uint64_t>(range) + 1));
    for (const int way : {0, 1, 2}) {
      std::vector<QuantisedPoint> points = before;
      QuantisedPoint* const middle = way == 0   ? split(points, axis, at)
                                     : way == 1 ? split_few(points, axis, at)
                                                : split_few_back(points, axis, at);
      for (QuantisedPoint* r = points.data(); r != points.data() + points.size(); ++r)
        EXPECT_EQ(r->q[axis] < at, r < middle);
      std::ranges::sort(points, {}, &QuantisedPoint::index);
      for (std::size_t i = 0; i < points.size(); ++i) EXPECT_EQ(points[i].q, before[i].q);
    }
    std::vector<std::uint32_t> bins(1024, 0);
    std::vector<std::uint32_t> odd(1024, 0);
    count_bins(before, axis, 0, 1, bins, odd);
    for (std::size_t b = 0; b < bins.size(); ++b) bins[b] += odd[b];
    QBounds bounds;
    widen(bounds, before);
    for (std::size_t a = 0; a < 3 && !before.empty(); ++a) {
      const auto value = [a](const QuantisedPoint& point) { return point.q[a]; };
      EXPECT_EQ(bounds.lo[a], std::ranges::min(before | std::views::transform(value)));
      EXPECT_EQ(bounds.hi[a], std::ranges::max(before | std::views::transform(value)));
    }
    EXPECT_EQ(bounds.empty(), before.empty());
    for (std::uint32_t b = 0; b < bins.size(); ++b)
      EXPECT_EQ(bins[b], static_cast<std::uint32_t>(std::ranges::count_if(before, [&](const QuantisedPoint& point) {
                  return static_cast<std::uint32_t>(point.q[axis]) / 2 == b;
                })));
  }
}

}  // namespace
}  // namespace rcb::partition
