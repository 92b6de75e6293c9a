// Exact counts, inside the shape, spread evenly, the same every time.
#include "client/solvers/mpm/sampling.hpp"

#include <algorithm>
#include <numbers>

#include <gtest/gtest.h>

namespace rcb::solvers {
namespace {

Shape ball() {
  return {{-1, -1, -1}, {1, 1, 1}, 4.0 / 3.0 * std::numbers::pi, [](const Vec3& x) { return dot(x, x) <= 1; }};
}

TEST(Fill, ExactlyAsManyAsAsked) {
  for (std::size_t count = 0; count < 300; ++count) ASSERT_EQ(fill(ball(), count, 1).size(), count);
  for (const std::size_t count : {750U, 751U, 999U, 4096U, 10'007U, 131'071U})
    ASSERT_EQ(fill(ball(), count, 1).size(), count);
}

TEST(Fill, AllInsideAndNoCommonCoordinates) {
  Cloud cloud = fill(ball(), 5000, 7);
  for (std::size_t p = 0; p < cloud.size(); ++p) {
    const Vec3 x{cloud.position[0][p], cloud.position[1][p], cloud.position[2][p]};
    ASSERT_LE(dot(x, x), 1);
  }
  for (auto& axis : cloud.position) {
    std::sort(axis.begin(), axis.end());
    EXPECT_EQ(std::adjacent_find(axis.begin(), axis.end()), axis.end());
  }
}

TEST(Fill, SpreadsEvenly) {
  // Each octant holds an eighth; no slab as thin as a lattice spacing is crowded, which an aligned lattice's would be.
  const Cloud cloud = fill(ball(), 8000, 3);
  std::array<int, 8> octants{};
  std::array<int, 100> slabs{};
  for (std::size_t p = 0; p < cloud.size(); ++p) {
    const auto side = [&](std::size_t a) { return cloud.position[a][p] > 0 ? 1U : 0U; };
    ++octants[side(0) * 4 + side(1) * 2 + side(2)];
    ++slabs[static_cast<std::size_t>((cloud.position[0][p] + 1) * 50)];
  }
  for (const int count : octants) EXPECT_NEAR(count, 1000, 60);
  for (const int count : slabs) EXPECT_LE(count, 180);  // 120 in the middle if perfectly even
}

TEST(Fill, SameArgumentsSameBits) {
  EXPECT_EQ(fill(ball(), 2001, 5).position, fill(ball(), 2001, 5).position);
  EXPECT_NE(fill(ball(), 2001, 5).position, fill(ball(), 2001, 6).position);
}

}  // namespace
}  // namespace rcb::solvers
