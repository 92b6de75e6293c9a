// The sediment's law: its return mapping against what it promises, and the angle at which a layer of it gives way.
#include "client/solvers/mpm/granular.hpp"

#include <cmath>
#include <limits>
#include <memory>
#include <numbers>
#include <vector>

#include <gtest/gtest.h>

#include "client/solvers/mpm/mpm.hpp"
#include "common/base/random.hpp"

namespace rcb::solvers {
namespace {

constexpr std::uint64_t kGranularSeed = 20261121;

Granular sediment(double angle = 30) { return Granular::create(1800, 1e7, 0.3, angle).value(); }

Mat3 diagonal(double x, double y, double z) { return {{x, 0, 0, 0, y, 0, 0, 0, z}}; }

struct Point {
  Mat3 f = Mat3::identity();
  double memory = 0;
  Mat3 tau;
};

void update(const Granular& law, Point& point) {
  ASSERT_EQ(law.update({&point.f, 1}, {&point.memory, 1}, {&point.tau, 1}).broken, StressPass::kNone);
}

double pressure(const Mat3& tau) { return -(tau(0, 0) + tau(1, 1) + tau(2, 2)) / 3; }

double shear(const Mat3& tau) {
  Mat3 s = tau;
  for (std::size_t i = 0; i < 3; ++i) s(i, i) += pressure(tau);
  return std::sqrt(sum_of_squares(s));
}

Mat3 random_growth(Random& random, double size) {
  Mat3 f = Mat3::identity();
  for (double& entry : f.e) entry += random.uniform(-size, size);
  return f;
}

// Long random paths of small and of large steps: the cone is never left, energy never comes from nowhere.
TEST(Granular, StressStaysInTheConeAndTheReturnOnlyDissipates) {
  for (const double angle : {15.0, 30.0, 60.0})
    for (const double size : {1e-4, 3e-3, 0.1}) {
      const Granular law = sediment(angle);
      Random random(kGranularSeed);
      int elastic = 0;
      int cone = 0;
      int tip = 0;
      Point point;
      for (int step = 0; step < 3000; ++step) {
        point.f = random_growth(random, size) * point.f;
        // Held near where it just touches, so that it bears, shears and comes apart by turns.
        const double hold = std::exp(-0.1 * (std::log(determinant(point.f)) + point.memory + 2 * size));
        point.f = diagonal(hold, hold, hold) * point.f;
        const Point trial = point;
        const Sym3 strain = 0.5 * log(left_square(trial.f));
        Sym3 deviator = strain;
        deviator.add_to_diagonal(-strain.trace() / 3);
        const double volume = std::min(0.0, strain.trace() + trial.memory);
        const double stored_trial = law.mu() * norm_squared(deviator) + 0.5 * law.bulk() * volume * volume;
        update(law, point);
        const double p = pressure(point.tau);
        const double scale = law.mu();
        ASSERT_GE(p, -1e-12 * scale) << "no tension; seed " << kGranularSeed << " step " << step;
        ASSERT_LE(shear(point.tau), law.cone() * p + 1e-12 * scale) << "seed " << kGranularSeed << " step " << step;
        const double stored = law.energy_density(point.f, point.memory);
        ASSERT_LE(stored, stored_trial * (1 + 1e-9) + 1e-15 * scale) << "seed " << kGranularSeed << " step " << step;
        ASSERT_NEAR(law.energy_density(trial.f, trial.memory), stored, 1e-9 * stored + 1e-15 * scale)
            << "the energy is told as after the return";
        // What the point keeps is what its stress came from: a second look changes nothing.
        Point again = point;
        update(law, again);
        ASSERT_NEAR(shear(again.tau), shear(point.tau), 1e-9 * shear(point.tau) + 1e-12 * scale);
        ASSERT_NEAR(pressure(again.tau), p, 1e-9 * p + 1e-12 * scale);
        if (p == 0)
          ++tip;
        else if (shear(point.tau) >= law.cone() * p * (1 - 1e-9))
          ++cone;
        else
          ++elastic;
      }
      EXPECT_GT(tip, 10) << angle << " " << size;
      EXPECT_GT(cone, 10) << angle << " " << size;
      EXPECT_GT(elastic, 10) << angle << " " << size;
    }
}

TEST(Granular, InsideTheConeItIsHenckysSolid) {
  const Granular law = sediment();
  const double strain[3] = {-0.02, -0.024, -0.018};
  const double c = std::cos(0.6);
  const double s = std::sin(0.6);
  const Mat3 turn{{c, -s, 0, s, c, 0, 0, 0, 1}};
  Point point;
  point.f = diagonal(std::exp(strain[0]), std::exp(strain[1]), std::exp(strain[2])) * turn;
  const Mat3 before = point.f;
  update(law, point);
  EXPECT_EQ(point.f.e, before.e) << "left alone, to the bit";
  EXPECT_EQ(point.memory, 0);
  const double volume = strain[0] + strain[1] + strain[2];
  for (std::size_t i = 0; i < 3; ++i)
    EXPECT_NEAR(point.tau(i, i), law.bulk() * volume + 2 * law.mu() * (strain[i] - volume / 3), 1e-12 * law.bulk());
  EXPECT_NEAR(point.tau(0, 1), 0, 1e-12 * law.bulk());
}

TEST(Granular, TheReturnKeepsPressureAndDirection) {
  const Granular law = sediment();
  Point point;
  point.f = diagonal(std::exp(-0.03), std::exp(0.01), std::exp(0.005));
  update(law, point);
  EXPECT_NEAR(pressure(point.tau), law.bulk() * 0.015, 1e-10 * law.bulk());
  EXPECT_NEAR(shear(point.tau), law.cone() * law.bulk() * 0.015, 1e-10 * law.bulk());
  EXPECT_NEAR(determinant(point.f), std::exp(-0.015), 1e-13) << "shearing changes no volume";
  // Deviators of -0.025, 0.015 and 0.01.
  EXPECT_NEAR((point.tau(1, 1) + pressure(point.tau)) / (point.tau(0, 0) + pressure(point.tau)), -0.6, 1e-10);
}

// Plane strain at the yield: half the difference over half the sum of the principal stresses is sin(phi), which is
// what the friction angle means (Mohr and Coulomb).
TEST(Granular, YieldsAtTheFrictionAngleInPlaneStrain) {
  for (const double angle : {10.0, 25.0, 40.0}) {
    const Granular law = sediment(angle);
    Point point;
    point.f = diagonal(0.99, 0.99, 0.99);
    const double step = 1e-3;
    for (int k = 0; k < 200; ++k) {
      point.f = diagonal(std::exp(step), std::exp(-step), 1) * point.f;
      update(law, point);
    }
    const double x = -point.tau(0, 0);
    const double y = -point.tau(1, 1);
    EXPECT_NEAR((y - x) / (y + x), std::sin(angle * std::numbers::pi / 180), 1e-3) << angle;
  }
}

// A dry heap against a wall, its weight put on at once: what the angle of friction means to who stands in front of it.
// Returns how far its points went on average, as a share of its length.
double slump(double heap_angle, double friction_angle) {
  const double tangent = std::tan(heap_angle * std::numbers::pi / 180);
  MpmOptions options;
  options.spacing = 0.06;
  options.hi = {3, tangent + 0.12, 0.12};
  options.ground = {{{}, {0, 1, 0}}};
  Mpm mpm = Mpm::create(options).value();
  Shape shape;
  shape.hi = {1, tangent, options.hi[2]};
  shape.volume = 0.5 * tangent * options.hi[2];
  shape.inside = [&](const Vec3& x) {
    return x[0] >= 0 && x[1] >= 0 && x[2] >= 0 && x[2] <= options.hi[2] && x[1] <= tangent * (1 - x[0]);
  };
  const auto sand = std::make_shared<Granular>(Granular::create(1600, 2e6, 0.3, friction_angle).value());
  const Cloud start = fill(shape, 1000, 5);
  EXPECT_TRUE(mpm.add_body(sand, start, shape.volume, {}, {0, -9.81, 0}).ok());
  EXPECT_TRUE(mpm.advance(1).ok());
  double sum = 0;
  for (std::size_t p = 0; p < mpm.size(); ++p)
    sum += std::hypot(mpm.position(0)[p] - start.position[0][p], mpm.position(1)[p] - start.position[1][p]);
  return sum / static_cast<double>(mpm.size());
}

TEST(Granular, AHeapStandsBelowTheFrictionAngleAndSlumpsAboveIt) {
  for (const double friction : {25.0, 35.0}) {
    EXPECT_LT(slump(friction - 3, friction), 0.004) << friction;
    EXPECT_GT(slump(friction + 5, friction), 0.008) << friction;
  }
}

TEST(Granular, ComesApartWithoutStressAndClosesBeforeItBears) {
  const Granular law = sediment();
  Point point;
  const Mat3 open = diagonal(1.01, 1.01, 1.01);
  const Mat3 close = diagonal(1 / 1.01, 1 / 1.01, 1 / 1.01);
  for (int k = 0; k < 2; ++k) {
    point.f = open * point.f;
    update(law, point);
    EXPECT_EQ(sum_of_squares(point.tau), 0);
    EXPECT_EQ(point.f.e, Mat3::identity().e);
  }
  EXPECT_NEAR(point.memory, 6 * std::log(1.01), 1e-12);
  point.f = close * point.f;
  update(law, point);
  EXPECT_EQ(sum_of_squares(point.tau), 0) << "still open by half";
  EXPECT_NEAR(point.memory, 3 * std::log(1.01), 1e-12);
  point.f = close * close * point.f;
  update(law, point);
  EXPECT_EQ(point.memory, 0) << "closed";
  EXPECT_NEAR(pressure(point.tau), law.bulk() * 3 * std::log(1.01), 1e-9 * law.bulk());
}

TEST(Granular, WaveSpeedGrowsWithPressure) {
  const Granular law = sediment();
  std::vector<Mat3> f{Mat3::identity(), diagonal(0.9, 0.9, 0.9)};
  std::vector<double> memory(2);
  std::vector<Mat3> tau(2);
  const double rest = std::sqrt((law.bulk() + 4.0 / 3 * law.mu()) / 1800);
  EXPECT_NEAR(law.update(std::span(f).first(1), memory, tau).wave_speed_max, rest, 1e-9);
  const double pressed = law.update(f, memory, tau).wave_speed_max;
  EXPECT_GT(pressed, 1.05 * rest);
  EXPECT_LT(pressed, 1.2 * rest);
}

TEST(Granular, NamesTheFirstBrokenPoint) {
  const double infinity = std::numeric_limits<double>::infinity();
  for (const Mat3& bad :
       {diagonal(-1, 1, 1), diagonal(0, 1, 1), diagonal(std::nan(""), 1, 1), diagonal(infinity, 1, 1)}) {
    std::vector<Mat3> f{Mat3::identity(), bad, bad};
    std::vector<double> memory(3);
    std::vector<Mat3> tau(3);
    EXPECT_EQ(sediment().update(f, memory, tau).broken, 1U);
  }
}

TEST(Granular, RefusesWhatIsNoSediment) {
  for (const double angle : {0.0, -1.0, 90.0, std::nan("")})
    EXPECT_EQ(Granular::create(1800, 1e7, 0.3, angle).status().code(), Code::invalid_argument);
  EXPECT_EQ(Granular::create(0, 1e7, 0.3, 30).status().code(), Code::invalid_argument);
  EXPECT_EQ(Granular::create(1800, 0, 0.3, 30).status().code(), Code::invalid_argument);
  EXPECT_EQ(Granular::create(1800, 1e7, 0.5, 30).status().code(), Code::invalid_argument);
}

}  // namespace
}  // namespace rcb::solvers
