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
