// The core of the material point method: its transfers, its balances, its limits.
#include "client/solvers/mpm.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>

#include <gtest/gtest.h>

namespace rcb::solvers {
namespace {

constexpr double kBlock = 0.4;  // edge of the test body

std::shared_ptr<const Material> rubber() {
  return std::make_shared<NeoHookean>(NeoHookean::create(1000, 1e6, 0.3).value());
}

MpmOptions box() {
  MpmOptions options;
  options.lo = {-1, -1, -1};
  options.hi = {1, 1, 1};
  options.spacing = 0.08;
  return options;
}

Cloud block() {
  const double h = kBlock / 2;
  return fill({{-h, -h, -h},
               {h, h, h},
               kBlock * kBlock * kBlock,
               [h](const Vec3& x) {
                 return std::max({std::abs(x[0]), std::abs(x[1]), std::abs(x[2])}) <= h;
               }},
              1000, 11);
}

Mpm block_in(const MpmOptions& options, const Vec3& velocity, const Vec3& gravity) {
  Mpm mpm = Mpm::create(options).value();
  const Status added = mpm.add_body(rubber(), block(), kBlock * kBlock * kBlock, velocity, gravity);
  EXPECT_TRUE(added.ok()) << added.message();
  return mpm;
}

void advance(Mpm& mpm, double seconds) {
  const Status status = mpm.advance(seconds);
  ASSERT_TRUE(status.ok()) << status.message();
}

TEST(Spline, WeightsSumToOneAndPlaceThePoint) {
  for (int k = 0; k < 1000; ++k) {
    const double offset = 0.5 + k / 1000.0;
    const auto w = spline_weights(offset);
    EXPECT_NEAR(w[0] + w[1] + w[2], 1, 1e-15);
    EXPECT_NEAR(w[1] + 2 * w[2], offset, 1e-15);
    // The second moment about the point, which the affine transfer divides by.
    EXPECT_NEAR(w[0] * offset * offset + w[1] * (1 - offset) * (1 - offset) + w[2] * (2 - offset) * (2 - offset), 0.25,
                1e-15);
    EXPECT_GE(std::min({w[0], w[1], w[2]}), 0);
  }
}

TEST(Mpm, RigidTranslationChangesNothing) {
  const Vec3 velocity{3, -2, 1};
  Mpm mpm = block_in(box(), velocity, {});
  const Balance before = mpm.balance();
  const Cloud start = block();
  for (int step = 0; step < 50; ++step) advance(mpm, 0.002);
  const Balance after = mpm.balance();
  for (std::size_t a = 0; a < 3; ++a) {
    EXPECT_NEAR(after.momentum[a], before.momentum[a], 1e-10 * before.speed_sum);
    for (std::size_t p = 0; p < mpm.size(); ++p) {
      ASSERT_NEAR(mpm.velocity(a)[p], velocity[a], 1e-10);
      ASSERT_NEAR(mpm.position(a)[p], start.position[a][p] + 0.1 * velocity[a], 1e-11);
    }
  }
  EXPECT_NEAR(after.energy(), before.energy(), 1e-10 * before.energy());
  EXPECT_NEAR(after.elastic, 0, 1e-10 * before.energy());
}

TEST(Mpm, FreeFallGainsWhatGravityGives) {
  const Vec3 gravity{0.5, -9.81, 0};
  Mpm mpm = block_in(box(), {}, gravity);
  advance(mpm, 0.2);
  const double mass = 1000 * kBlock * kBlock * kBlock;
  for (std::size_t a = 0; a < 3; ++a) {
    EXPECT_NEAR(mpm.impulse()[a], mass * gravity[a] * 0.2, 1e-9);
    EXPECT_NEAR(mpm.balance().momentum[a], mpm.impulse()[a], 1e-9);
    for (std::size_t p = 0; p < mpm.size(); ++p) ASSERT_NEAR(mpm.velocity(a)[p], gravity[a] * 0.2, 1e-10);
  }
  // What is won in motion is lost in height, but for the first order of the time step.
  EXPECT_NEAR(mpm.balance().energy(), 0, 0.03 * mpm.balance().kinetic);
}

TEST(Mpm, BouncesOffTheWallAndCountsItsImpulse) {
  Mpm mpm = block_in(box(), {8, 3, 0}, {});
  const Balance before = mpm.balance();
  double energy_largest = 0;
  for (int step = 0; step < 100; ++step) {
    advance(mpm, 0.002);
    energy_largest = std::max(energy_largest, mpm.balance().energy());
  }
  const Balance after = mpm.balance();
  EXPECT_LT(after.momentum[0], -0.4 * before.momentum[0]) << "it should come back";
  EXPECT_NEAR(after.momentum[1], before.momentum[1], 1e-9 * before.speed_sum) << "the wall is smooth";
  for (std::size_t a = 0; a < 3; ++a)
    EXPECT_NEAR(after.momentum[a] - before.momentum[a], mpm.impulse()[a], 1e-10 * before.speed_sum);
  EXPECT_LE(energy_largest, before.energy() * (1 + 1e-9));
}

TEST(Mpm, StickyGroundHoldsSmoothGroundLetsSlide) {
  for (const bool sticky : {true, false}) {
    MpmOptions options = box();
    options.ground = {{{0, -0.2, 0}, {0, 1, 0}, sticky ? Ground::kSticky : 0}};
    Mpm mpm = block_in(options, {1, 0, 0}, {0, -9.81, 0});
    advance(mpm, 0.2);
    const double mass = 1000 * kBlock * kBlock * kBlock;
    if (sticky) {
      EXPECT_LT(std::abs(mpm.impulse()[0] + mass), 1.5 * mass);
      EXPECT_GT(std::abs(mpm.impulse()[0]), 0.3 * mass);
    } else {
      EXPECT_NEAR(mpm.impulse()[0], 0, 1e-10 * mass);
    }
    const auto y = mpm.position(1);
    EXPECT_GT(*std::min_element(y.begin(), y.end()), -0.25) << "the ground holds";
  }
}

TEST(Mpm, SubstepsKeepToTheSignalSpeed) {
  const NeoHookean law = NeoHookean::create(1000, 1e6, 0.3).value();
  const double wave = std::sqrt((law.lambda() + 2 * law.mu()) / 1000);
  for (const double speed : {0.0, 5.0, 50.0}) {
    Mpm mpm = block_in(box(), {speed, 0, 0}, {});
    advance(mpm, 0.01);
    const double least = 0.01 * (wave + speed) / (0.4 * 0.08);
    EXPECT_GE(static_cast<double>(mpm.substeps()), least);
    EXPECT_LE(static_cast<double>(mpm.substeps()), least + 2);
    EXPECT_EQ(mpm.time(), 0.01);
  }
}

TEST(Mpm, RefusesTooManySubsteps) {
  Mpm mpm = block_in(box(), {}, {});
  const Status status = mpm.advance(1e6);
  EXPECT_EQ(status.code(), Code::too_large);
  EXPECT_NE(status.message().find("substeps"), std::string::npos);
}

TEST(Mpm, NamesAPointThatLeftTheDomain) {
  Mpm mpm = block_in(box(), {}, {0, -1e9, 0});
  const Status status = mpm.advance(0.01);
  EXPECT_EQ(status.code(), Code::invalid_argument);
  EXPECT_NE(status.message().find("left the domain"), std::string::npos) << status.message();
}

TEST(Mpm, NotANumberNeverPasses) {
  Mpm mpm = block_in(box(), {std::nan(""), 0, 0}, {});
  EXPECT_FALSE(mpm.advance(0.01).ok());
}

TEST(Mpm, RefusesBodiesOutsideAndBadDomains) {
  MpmOptions options = box();
  options.hi[1] = 0.1;
  Mpm mpm = Mpm::create(options).value();
  EXPECT_EQ(mpm.add_body(rubber(), block(), 1, {}, {}).code(), Code::invalid_argument);
  EXPECT_EQ(mpm.size(), 0U);

  options = box();
  options.spacing = 1e-4;
  EXPECT_EQ(Mpm::create(options).status().code(), Code::too_large);
  options = box();
  options.hi[2] = options.lo[2];
  EXPECT_EQ(Mpm::create(options).status().code(), Code::invalid_argument);
  for (const double cfl : {0.0, 1.0, std::nan("")}) {
    options = box();
    options.cfl = cfl;
    EXPECT_EQ(Mpm::create(options).status().code(), Code::invalid_argument);
  }
}

}  // namespace
}  // namespace rcb::solvers
