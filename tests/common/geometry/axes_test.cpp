#include "common/geometry/axes.hpp"

#include <cmath>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include "common/geometry/box.hpp"

namespace rcb::geometry {
namespace {

using Limits = std::numeric_limits<double>;

TEST(Image, KeepsTheOrder) {
  const std::vector<double> ascending{Limits::lowest(),
                                      -1e300,
                                      -2.0,
                                      -1.0,
                                      -Limits::min(),
                                      -Limits::denorm_min(),
                                      0.0,
                                      Limits::denorm_min(),
                                      Limits::min(),
                                      1.0,
                                      std::nextafter(1.0, 2.0),
                                      1e300,
                                      Limits::max()};
  for (std::size_t i = 0; i < ascending.size(); ++i) {
    EXPECT_EQ(value_of_order_bits(order_bits(ascending[i])), ascending[i]);
    for (std::size_t j = 0; j < ascending.size(); ++j)
      EXPECT_EQ(order_bits(ascending[i]) < order_bits(ascending[j]), i < j) << ascending[i] << " " << ascending[j];
  }
}

TEST(Image, TakesBothZerosAsOne) {
  EXPECT_EQ(order_bits(-0.0), order_bits(0.0));
  EXPECT_FALSE(std::signbit(value_of_order_bits(order_bits(-0.0))));
}

TEST(Image, LeavesTheExtremesFree) {
  // The search uses all ones for "nothing".
  EXPECT_LT(order_bits(Limits::infinity()), ~std::uint64_t{0});
  EXPECT_GT(order_bits(-Limits::infinity()), 0U);
}

TEST(Axes, LongestFirstEqualByNumber) {
  EXPECT_EQ(order_by_extent({1, 2, 3}, 3), (AxisOrder{2, 1, 0}));
  EXPECT_EQ(order_by_extent({2, 2, 2}, 3), (AxisOrder{0, 1, 2}));
  EXPECT_EQ(order_by_extent({1, 2, 2}, 3), (AxisOrder{1, 2, 0}));
  EXPECT_EQ(order_by_extent({1, 2, 9}, 2), (AxisOrder{1, 0, 2}));
  EXPECT_EQ(with_first({2, 1, 0}, 0, 3), (AxisOrder{0, 2, 1}));
}

TEST(Axes, ExtentDoesNotOverflow) {
  EXPECT_EQ(extent(-Limits::max(), Limits::max()), Limits::max());
  EXPECT_EQ(extent(3, 3), 0);
}

TEST(Box, EmptyUntilExtended) {
  Box box;
  EXPECT_TRUE(box.empty(3));
  box.extend({1, 2, 3}, 3);
  box.extend({0, 5, 3}, 3);
  EXPECT_FALSE(box.empty(3));
  EXPECT_EQ(box.lo, (Point{0, 2, 3}));
  EXPECT_EQ(box.hi, (Point{1, 5, 3}));
}

}  // namespace
}  // namespace rcb::geometry
