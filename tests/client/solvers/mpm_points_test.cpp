// Points that are handed from core to core: whole, in order, and with their share of the balances.
#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include <gtest/gtest.h>

#include "client/solvers/mpm/granular.hpp"
#include "client/solvers/mpm/mpm.hpp"

namespace rcb::solvers {
namespace {

// Two bodies of sand that fall and spread; the second starts a little above the first.
Mpm heap() {
  MpmOptions options;
  options.lo = {-1, 0, -1};
  options.hi = {1, 1, 1};
  options.spacing = 0.1;
  options.ground = {{{0, 0.05, 0}, {0, 1, 0}, 0.3}};
  Mpm mpm = Mpm::create(options).value();
  const auto sand = std::make_shared<Granular>(Granular::create(1500, 1e6, 0.3, 30).value());
  for (const double foot : {0.1, 0.4}) {
    const Shape shape{{-0.2, foot, -0.2}, {0.2, foot + 0.2, 0.2}, 0.032, [foot](const Vec3& x) {
                        return std::abs(x[0]) <= 0.2 && x[1] >= foot && x[1] <= foot + 0.2 && std::abs(x[2]) <= 0.2;
                      }};
    EXPECT_TRUE(mpm.add_body(sand, fill(shape, 150, 5), shape.volume, {1, -1, 0}, {0, -9.81, 0}).ok());
  }
  return mpm;
}

std::vector<std::size_t> places_where(const Mpm& mpm, int remainder) {
  std::vector<std::size_t> places;
  for (std::size_t p = 0; p < mpm.size(); ++p)
    if (mpm.id()[p] % 3 == remainder) places.push_back(p);
  return places;
}

std::vector<PointState> states(const Mpm& mpm, const std::vector<std::size_t>& places) {
  std::vector<PointState> out;
  for (const std::size_t p : places) out.push_back(mpm.point(p));
  return out;
}

TEST(MpmPoints, LeaveAndComeBackAsTheyWere) {
  Mpm core = heap();
  Mpm other = heap();
  const auto all = [](const Mpm& mpm) {
    std::vector<std::size_t> places(mpm.size());
    for (std::size_t p = 0; p < places.size(); ++p) places[p] = p;
    return places;
  };
  other.exchange(all(other), {});
  EXPECT_EQ(other.size(), 0U);
  ASSERT_TRUE(core.advance(0.05).ok());
  const Mpm before = core;
  for (const int remainder : {1, 0}) {
    auto leaving = places_where(core, remainder);
    auto arriving = states(core, leaving);
    std::reverse(arriving.begin(), arriving.end());
    core.exchange(leaving, {});
    other.exchange({}, arriving);
    EXPECT_EQ(core.size() + other.size(), before.size());
    EXPECT_NEAR(core.balance().potential + other.balance().potential, before.balance().potential, 1e-9);
    EXPECT_NEAR(core.balance().energy() + other.balance().energy(), before.balance().energy(), 1e-9);
  }
  const auto back = all(other);
  core.exchange(places_where(core, 2), states(other, back));  // out with the last third, in with all others
  EXPECT_EQ(core.size(), 200U);
  const auto kept = places_where(before, 2);
  core.exchange({}, states(before, kept));
  ASSERT_EQ(core.size(), before.size());
  for (std::size_t p = 0; p < core.size(); ++p) {
    EXPECT_EQ(core.id()[p], static_cast<std::int64_t>(p));
    const PointState now = core.point(p), then = before.point(p);
    EXPECT_EQ(now.body, then.body);
    EXPECT_EQ(now.position, then.position);
    EXPECT_EQ(now.velocity, then.velocity);
    EXPECT_EQ(now.memory, then.memory);
    for (std::size_t k = 0; k < 9; ++k) {
      EXPECT_EQ(now.affine.e[k], then.affine.e[k]);
      EXPECT_EQ(now.deformation.e[k], then.deformation.e[k]);
    }
  }
  Mpm same = before;
  ASSERT_TRUE(core.advance(0.05).ok());
  ASSERT_TRUE(same.advance(0.05).ok());
  for (std::size_t p = 0; p < core.size(); ++p) EXPECT_EQ(core.position(0)[p], same.position(0)[p]) << "point " << p;
}

}  // namespace
}  // namespace rcb::solvers
