#include "common/particles/block_ranges.hpp"

#include <algorithm>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include "common/base/random.hpp"

namespace rcb::particles {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// Every length and place, so that each width of instruction and what is left over has its turn.
TEST(BlockRanges, AnExtremeIsSeenWhereverItStands) {
  for (std::size_t count = 1; count <= kBlock + 6; ++count) {
    std::vector<double> values(count, 0.5);
    for (std::size_t at = 0; at < count; ++at) {
      const double others_lo = count == 1 ? kInfinity : 0.5;
      const double others_hi = count == 1 ? -kInfinity : 0.5;
      for (const double value : {0.5, 0.25, -3.0, 7.0, kInfinity, -kInfinity}) {
        values[at] = value;
        const Range range = range_of(values);
        EXPECT_EQ(range.lo, std::min(value, others_lo)) << value << " at " << at << " of " << count;
        EXPECT_EQ(range.hi, std::max(value, others_hi)) << value << " at " << at << " of " << count;
      }
      for (const double value : {kNan, -kNan}) {
        values[at] = value;
        const Range range = range_of(values);
        EXPECT_EQ(range.lo, -kInfinity) << at << " of " << count;
        EXPECT_EQ(range.hi, kInfinity) << at << " of " << count;
        EXPECT_FALSE(range.strictly_inside(-kInfinity, kInfinity)) << at << " of " << count;
      }
      values[at] = 0.5;
    }
  }
}

// As they arrive: stretches that begin and end anywhere, and cross blocks.
TEST(BlockRanges, StretchesInAnyOrderGiveTheRangesOfTheWhole) {
  constexpr std::size_t kCount = 5 * kBlock + 7;
  Random random(3);
  std::vector<double> values(kCount);
  for (double& value : values) value = random.uniform();
  values[2 * kBlock] = kNan;
  for (int round = 0; round < 100; ++round) {
    std::vector<std::size_t> ends{0, kCount};
    for (int k = 0; k < 8; ++k) ends.push_back(random.below(kCount + 1));
    std::sort(ends.begin(), ends.end());
    BlockRanges ranges;
    ASSERT_TRUE(ranges.try_reset(1, kCount));
    for (std::size_t k = ends.size() - 1; k > 0; --k)
      ranges.extend(0, ends[k - 1], std::span(values).subspan(ends[k - 1], ends[k] - ends[k - 1]));
    ASSERT_EQ(ranges.of[0].size(), blocks_of(kCount));
    for (std::size_t b = 0; b < blocks_of(kCount); ++b) {
      const std::size_t size = std::min(kBlock, kCount - b * kBlock);
      const Range whole = range_of(std::span(values).subspan(b * kBlock, size));
      EXPECT_EQ(ranges.of[0][b].lo, whole.lo);
      EXPECT_EQ(ranges.of[0][b].hi, whole.hi);
    }
  }
}

TEST(BlockRanges, NothingIsInsideItsOwnBounds) {
  const std::vector<double> values{-0.0, 1, 2};
  const Range range = range_of(values);
  EXPECT_TRUE(range.strictly_inside(-0.1, 2.1));
  EXPECT_TRUE(range.strictly_inside(-kInfinity, kInfinity));
  EXPECT_FALSE(range.strictly_inside(0.0, 2.1));
  EXPECT_FALSE(range.strictly_inside(-0.1, 2));
  EXPECT_FALSE(range_of(std::vector<double>{1, kInfinity}).strictly_inside(-kInfinity, kInfinity));
  EXPECT_FALSE(range_of(std::vector<double>{-kInfinity}).strictly_inside(-kInfinity, kInfinity));
}

}  // namespace
}  // namespace rcb::particles
