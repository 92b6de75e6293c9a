// The core of the material point method: its transfers, its balances, its limits.
#include "client/solvers/mpm/mpm.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <vector>

#include <gtest/gtest.h>

#include "client/solvers/mpm/granular.hpp"

namespace rcb::solvers {
namespace {

constexpr double kBlock = 0.4;  // edge of the test body

std::shared_ptr<const Material> rubber_body() {
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
  const Status added = mpm.add_body(rubber_body(), block(), kBlock * kBlock * kBlock, velocity, gravity);
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

// A block on a bed that falls by `slope` per unit length: while all of it slides the bed's push leans back by just the
// friction, and at rest it is held. On a bed that lies along the grid (gravity tilted) and on one that lies across it.
TEST(Mpm, CoulombFrictionHoldsABlockAndSlowsASlidingOne) {
  const double friction = 0.3;
  const double slope = 0.2;
  const double c = 1 / std::sqrt(1 + slope * slope);
  const double s = slope * c;
  for (const double speed : {0.0, 1.5})
    for (const bool across : {false, true}) {
      const Vec3 up = across ? Vec3{s, c, 0} : Vec3{0, 1, 0};
      const Vec3 along = across ? Vec3{c, -s, 0} : Vec3{1, 0, 0};
      const Vec3 gravity = across ? Vec3{0, -9.81, 0} : Vec3{9.81 * s, -9.81 * c, 0};
      MpmOptions options = box();
      options.ground = {{-0.2 * up, up, friction}};
      Mpm mpm = Mpm::create(options).value();
      const double h = kBlock / 2;
      Shape shape;
      shape.lo = {-0.3, -0.3, -h};
      shape.hi = {0.3, 0.3, h};
      shape.volume = kBlock * kBlock * kBlock;
      shape.inside = [&](const Vec3& x) {
        return std::max({std::abs(dot(x, up)), std::abs(dot(x, along)), std::abs(x[2])}) <= h;
      };
      ASSERT_TRUE(mpm.add_body(rubber_body(), fill(shape, 1000, 11), shape.volume, speed * along, gravity).ok());
      const double mass = 1000 * shape.volume;
      advance(mpm, 0.3);
      const Vec3 push = mpm.impulse() - 0.3 * mass * gravity;  // of the bed
      const double weight = 9.81 * c * mass * 0.3;
      const double end = dot(along, mpm.balance().momentum) / mass;
      EXPECT_NEAR(dot(up, push), weight, 0.25 * weight) << "but for a bounce; across " << across;
      if (speed > 0) {
        EXPECT_NEAR(dot(along, push), -friction * dot(up, push), 0.01 * friction * weight) << "across " << across;
        EXPECT_NEAR(end, speed + 9.81 * (s - friction * c) * 0.3, 0.05 * speed) << "across " << across;
      } else {
        EXPECT_NEAR(end, 0, 0.1 * 9.81 * s * 0.3) << "across " << across;
      }
    }
}

void put_where_touched(Mpm& core, const std::vector<Node>& sum) {
  const NodeBox& box = core.touched();
  for (std::size_t i = box.first[0]; i < box.last[0]; ++i)
    for (std::size_t j = box.first[1]; j < box.last[1]; ++j)
      for (std::size_t k = box.first[2]; k < box.last[2]; ++k) {
        const std::size_t n = (i * core.grid_nodes()[1] + j) * core.grid_nodes()[2] + k;
        core.grid()[n] = sum[n];
      }
}

// Two cores, each with every other point of one body, their grids summed by hand, against one core with all of it.
TEST(Mpm, CoresThatShareAGridMoveAsOne) {
  MpmOptions options = box();
  options.ground = {{{0, -0.2, 0}, {0, 1, 0}, 0.3}};
  const double volume = kBlock * kBlock * kBlock;
  const Vec3 velocity{2, -1, 0.5};
  const Vec3 gravity{0, -9.81, 0};
  const auto sand = std::make_shared<Granular>(Granular::create(1000, 1e6, 0.3, 30).value());
  const Cloud all = block();
  std::array<Cloud, 2> halves;
  for (std::size_t a = 0; a < 3; ++a)
    for (std::size_t p = 0; p < all.size(); ++p) halves[p % 2].position[a].push_back(all.position[a][p]);
  Mpm whole = Mpm::create(options).value();
  ASSERT_TRUE(whole.add_body(sand, all, volume, velocity, gravity).ok());
  std::vector<Mpm> cores;
  for (const Cloud& half : halves) {
    cores.push_back(Mpm::create(options).value());
    ASSERT_TRUE(cores.back().add_body(sand, half, volume / 2, velocity, gravity).ok());
  }
  for (int step = 0; step < 60; ++step) {
    double signal = 0;
    for (Mpm& core : cores) signal = std::max(signal, core.update_stress().value());
    const double dt = cores[0].dt_max(signal);
    ASSERT_NEAR(whole.dt_max(whole.update_stress().value()), dt, 1e-3 * dt) << "step " << step;
    for (Mpm& core : cores) core.particles_to_grid(dt);
    std::vector<Node> sum(cores[0].grid().size(), Node{});
    for (Mpm& core : cores)
      for (std::size_t n = 0; n < sum.size(); ++n)
        for (std::size_t k = 0; k < 4; ++k) sum[n].value[k] += core.grid()[n].value[k];
    for (Mpm& core : cores) put_where_touched(core, sum);
    whole.particles_to_grid(dt);
    for (Mpm* core : {&cores[0], &cores[1], &whole}) {
      core->update_grid();
      ASSERT_TRUE(core->grid_to_particles(dt).ok());
    }
  }
  for (std::size_t p = 0; p < all.size(); ++p)
    for (std::size_t a = 0; a < 3; ++a) {
      ASSERT_NEAR(cores[p % 2].position(a)[p / 2], whole.position(a)[p], 1e-9) << "point " << p;
      ASSERT_NEAR(cores[p % 2].velocity(a)[p / 2], whole.velocity(a)[p], 1e-6) << "point " << p;
    }
}

TEST(Mpm, TouchesOnlyTheGridRoundItsPoints) {
  Mpm mpm = block_in(box(), {40, 0, 0}, {});
  for (int step = 0; step < 40; ++step) {
    const double dt = mpm.dt_max(mpm.update_stress().value());
    mpm.particles_to_grid(dt);
    const NodeBox& box = mpm.touched();
    double mass = 0;
    double mass_inside = 0;
    std::size_t n = 0;
    for (std::size_t i = 0; i < mpm.grid_nodes()[0]; ++i)
      for (std::size_t j = 0; j < mpm.grid_nodes()[1]; ++j)
        for (std::size_t k = 0; k < mpm.grid_nodes()[2]; ++k, ++n) {
          mass += mpm.grid()[n].value[3];
          if (i >= box.first[0] && i < box.last[0] && j >= box.first[1] && j < box.last[1] && k >= box.first[2] &&
              k < box.last[2])
            mass_inside += mpm.grid()[n].value[3];
        }
    ASSERT_NEAR(mass, 1000 * kBlock * kBlock * kBlock, 1e-9) << "nothing is left from the last substep";
    ASSERT_EQ(mass, mass_inside);
    mpm.update_grid();
    ASSERT_TRUE(mpm.grid_to_particles(dt).ok());
  }
}

// Without walls and weight, sand that is squeezed, sheared and torn keeps momentum and only loses energy.
TEST(Mpm, SandKeepsMomentumToRoundingAndOnlyLosesEnergy) {
  Mpm mpm = Mpm::create(box()).value();
  const auto sand = std::make_shared<Granular>(Granular::create(1000, 1e6, 0.3, 30).value());
  const double h = kBlock / 2;
  for (const double side : {-1.0, 1.0}) {  // two halves thrown at each other, a little askew
    Shape shape;
    shape.lo = {side < 0 ? -h : 0, -h, -h};
    shape.hi = {side < 0 ? 0 : h, h, h};
    shape.volume = 0.5 * kBlock * kBlock * kBlock;
    shape.inside = [&shape](const Vec3& x) {
      for (std::size_t a = 0; a < 3; ++a)
        if (x[a] < shape.lo[a] || x[a] > shape.hi[a]) return false;
      return true;
    };
    ASSERT_TRUE(mpm.add_body(sand, fill(shape, 800, 7), shape.volume, {-side * 1.5 + 1, side * 1.0, 0.5}, {}).ok());
  }
  const Balance start = mpm.balance();
  double energy = start.energy();
  for (int step = 0; step < 40; ++step) {
    advance(mpm, 0.002);
    const Balance now = mpm.balance();
    for (std::size_t a = 0; a < 3; ++a) {
      ASSERT_NEAR(now.momentum[a], start.momentum[a], 1e-12 * start.speed_sum) << "step " << step;
      ASSERT_NEAR(now.angular[a], start.angular[a], 1e-12 * start.speed_sum) << "step " << step;
    }
    ASSERT_LE(now.energy(), energy * (1 + 1e-9)) << "step " << step;
    energy = now.energy();
  }
  EXPECT_EQ(mpm.impulse(), Vec3{}) << "no wall took part";
  EXPECT_LT(energy, 0.8 * start.energy()) << "plastic work was done";
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
  EXPECT_EQ(mpm.add_body(rubber_body(), block(), 1, {}, {}).code(), Code::invalid_argument);
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
