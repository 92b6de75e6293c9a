// Passes over quantised points, against plain loops: sizes around those of their blocks, and shares from none to all.
#include "common/partition/points/segment.hpp"

#include <algorithm>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "common/base/index.hpp"
#include "common/base/random.hpp"

namespace rcb::partition {
namespace {

// Integers in [0, most], of which `sorted` has one in eight out of order.
std::vector<QuantisedPoint> points_up_to(Random& random, std::size_t count, std::uint64_t most, bool sorted) {
  std::vector<QuantisedPoint> points(count);
  for (std::size_t i = 0; i < count; ++i) {
    for (std::int32_t& q : points[i].q)
      q = static_cast<std::int32_t>(sorted && random.below(8) != 0 ? i * most / count : random.below(most + 1));
    points[i].index = static_cast<std::uint32_t>(i);
  }
  return points;
}

constexpr std::array<std::size_t, 12> kDividedSizes{0, 1, 2, 3, 5, 8, 64, 511, 512, 513, 1024, 3001};

TEST(Divide, MovesTheLesserOnesToTheFront) {
  Random random(20261129);
  for (const std::size_t count : kDividedSizes)
    for (const std::uint64_t most : {std::uint64_t{0}, std::uint64_t{7}, std::uint64_t{LinearMaps::kTop}})
      for (const bool sorted : {false, true})
        for (const std::uint64_t eighths : {0U, 1U, 4U, 7U, 8U}) {
          const std::size_t axis = random.below(geometry::kDimsMax);
          const std::vector<QuantisedPoint> before = points_up_to(random, count, most, sorted);
          const auto first_right = static_cast<std::int32_t>((most + 1) * eighths / 8);
          SCOPED_TRACE(fmt::format("{} points up to {}, sorted {}, at {}", count, most, sorted, first_right));
          std::vector<QuantisedPoint> points = before;
          const auto left = divide(points, axis, first_right) - points.data();
          const auto is_left = [&](const QuantisedPoint& point) { return point.q[axis] < first_right; };
          ASSERT_EQ(left, std::ranges::count_if(before, is_left));
          ASSERT_TRUE(std::all_of(points.begin(), points.begin() + left, is_left));
          std::ranges::sort(points, {}, &QuantisedPoint::index);
          for (std::size_t i = 0; i < count; ++i) {  // none is lost, doubled or torn
            ASSERT_EQ(points[i].index, i);
            ASSERT_EQ(points[i].q, before[i].q);
          }
        }
}

TEST(CountBins, AddsOneForEachPoint) {
  Random random(20261130);
  for (const std::size_t count : kDividedSizes)
    for (const unsigned shift : {0U, 3U, 20U}) {
      const std::size_t bins = 1 + random.below(100);
      const std::size_t axis = random.below(geometry::kDimsMax);
      const auto lo = static_cast<std::int32_t>(random.below(1U << 30U));
      std::vector<QuantisedPoint> points = points_up_to(random, count, (bins << shift) - 1, false);
      std::vector<std::uint64_t> expected(bins, 3);
      for (QuantisedPoint& point : points) {
        ++expected[at(point.q[axis]) / (std::size_t{1} << shift)];
        point.q[axis] += lo;
      }
      std::vector<std::uint64_t> even(bins, 1);
      std::vector<std::uint64_t> odd(bins, 2);
      count_bins(points, axis, lo, shift, even, odd);
      for (std::size_t b = 0; b < bins; ++b) ASSERT_EQ(even[b] + odd[b], expected[b]) << count << " points, bin " << b;
    }
}

}  // namespace
}  // namespace rcb::partition
