// The neo-Hookean law against closed forms, and its stress against the slope of its energy.
#include "client/solvers/mpm/material.hpp"

#include <cmath>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include "common/base/random.hpp"

namespace rcb::solvers {
namespace {

NeoHookean rubber() { return NeoHookean::create(1000, 1e6, 0.3).value(); }

Mat3 stretch(double x, double y, double z) { return {{x, 0, 0, 0, y, 0, 0, 0, z}}; }

Mat3 stress_of(const NeoHookean& law, Mat3 f) {
  Mat3 tau;
  EXPECT_EQ(law.update({&f, 1}, {}, {&tau, 1}).broken, StressPass::kNone);
  return tau;
}

TEST(NeoHookean, ModuliFromYoungAndPoisson) {
  EXPECT_NEAR(rubber().mu(), 1e6 / 2.6, 1e-6);
  EXPECT_NEAR(rubber().lambda(), 0.3e6 / (1.3 * 0.4), 1e-6);
}

TEST(NeoHookean, UniaxialStrainAsOnPaper) {
  const NeoHookean law = rubber();
  for (const double s : {0.5, 0.9, 1.0, 1.1, 2.0}) {
    const Mat3 tau = stress_of(law, stretch(s, 1, 1));
    EXPECT_NEAR(tau(0, 0), law.mu() * (s * s - 1) + law.lambda() * std::log(s), 1e-6);
    EXPECT_NEAR(tau(1, 1), law.lambda() * std::log(s), 1e-6);
    EXPECT_NEAR(tau(2, 2), law.lambda() * std::log(s), 1e-6);
    EXPECT_EQ(tau(0, 1), 0);
  }
}

TEST(NeoHookean, SmallUniaxialStressFollowsYoungsModulus) {
  // Sides contract by Poisson's ratio: no stress across, E times strain along.
  const double strain = 1e-6;
  const Mat3 tau = stress_of(rubber(), stretch(1 + strain, 1 - 0.3 * strain, 1 - 0.3 * strain));
  EXPECT_NEAR(tau(0, 0), 1e6 * strain, 1e-5);
  EXPECT_NEAR(tau(1, 1), 0, 1e-5);
}

TEST(NeoHookean, StressIsTheSlopeOfTheEnergy) {
  const NeoHookean law = rubber();
  const std::uint64_t seed = 20240611;
  Random random(seed);
  for (int repeat = 0; repeat < 50; ++repeat) {
    Mat3 f = Mat3::identity();
    for (double& entry : f.e) entry += random.uniform(-0.25, 0.25);
    Mat3 slope;  // d energy / d F by central differences
    for (std::size_t k = 0; k < 9; ++k) {
      Mat3 up = f;
      Mat3 down = f;
      up.e[k] += 1e-6;
      down.e[k] -= 1e-6;
      slope.e[k] = (law.energy_density(up) - law.energy_density(down)) / 2e-6;
    }
    const Mat3 tau = stress_of(law, f);
    for (std::size_t i = 0; i < 3; ++i)
      for (std::size_t j = 0; j < 3; ++j)
        EXPECT_NEAR(tau(i, j), slope(i, 0) * f(j, 0) + slope(i, 1) * f(j, 1) + slope(i, 2) * f(j, 2), 1.0)
            << "seed " << seed << " repeat " << repeat;
  }
}

TEST(NeoHookean, RotationCostsNothing) {
  const double c = std::cos(0.7);
  const double s = std::sin(0.7);
  const Mat3 turn{{c, -s, 0, s, c, 0, 0, 0, 1}};
  EXPECT_NEAR(rubber().energy_density(turn), 0, 1e-9);
  for (const double entry : stress_of(rubber(), turn).e) EXPECT_NEAR(entry, 0, 1e-8);
  const Mat3 stretched = stretch(1.2, 0.9, 1.0);
  EXPECT_NEAR(rubber().energy_density(turn * stretched), rubber().energy_density(stretched), 1e-8);
}

TEST(NeoHookean, WaveSpeedAtRestIsThatOfLinearElasticity) {
  const NeoHookean law = rubber();
  Mat3 f = Mat3::identity();
  Mat3 tau;
  EXPECT_NEAR(law.update({&f, 1}, {}, {&tau, 1}).wave_speed_max, std::sqrt((law.lambda() + 2 * law.mu()) / 1000), 1e-9);
}

TEST(NeoHookean, StretchedPointsCarryFasterWaves) {
  // Along the stretch, rho c^2 = s^2 dP/ds with P = d energy / ds in uniaxial strain.
  const NeoHookean law = rubber();
  for (const double s : {0.4, 0.8, 1.5}) {
    const double h = 1e-4;
    const double curvature = (law.energy_density(stretch(s + h, 1, 1)) - 2 * law.energy_density(stretch(s, 1, 1)) +
                              law.energy_density(stretch(s - h, 1, 1))) /
                             (h * h);
    Mat3 f = stretch(s, 1, 1);
    Mat3 tau;
    const double bound = law.update({&f, 1}, {}, {&tau, 1}).wave_speed_max;
    EXPECT_GE(bound * (1 + 1e-6), std::sqrt(s * s * curvature / 1000));
    EXPECT_LE(bound, 2 * std::sqrt(s * s * curvature / 1000));
  }
}

TEST(NeoHookean, NamesTheFirstBrokenPoint) {
  for (const Mat3& bad : {stretch(-1, 1, 1), stretch(0, 1, 1), stretch(std::nan(""), 1, 1),
                          stretch(std::numeric_limits<double>::infinity(), 1, 1)}) {
    std::vector<Mat3> f{Mat3::identity(), bad, bad};
    std::vector<Mat3> tau(3);
    EXPECT_EQ(rubber().update(f, {}, tau).broken, 1U);
  }
}

TEST(NeoHookean, RefusesWhatIsNoMaterial) {
  EXPECT_EQ(NeoHookean::create(0, 1e6, 0.3).status().code(), Code::invalid_argument);
  EXPECT_EQ(NeoHookean::create(1000, -1, 0.3).status().code(), Code::invalid_argument);
  EXPECT_EQ(NeoHookean::create(1000, 1e6, 0.5).status().code(), Code::invalid_argument);
  EXPECT_EQ(NeoHookean::create(1000, std::nan(""), 0.3).status().code(), Code::invalid_argument);
}

}  // namespace
}  // namespace rcb::solvers
