// Logarithm and exponential of symmetric matrices: inverse to each other, and the series against the principal axes.
#include "client/solvers/mpm/symmetric.hpp"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "common/base/random.hpp"

namespace rcb::solvers {
namespace {

constexpr std::uint64_t kSymmetricSeed = 20261121;

Sym3 random_matrix(Random& random, double size) {
  Sym3 m;
  for (double* entry : {&m.xx, &m.yy, &m.zz, &m.xy, &m.xz, &m.yz}) *entry = random.uniform(-size, size);
  return m;
}

double distance(const Sym3& a, const Sym3& b) {
  return std::sqrt(norm_squared({a.xx - b.xx, a.yy - b.yy, a.zz - b.zz, a.xy - b.xy, a.xz - b.xz, a.yz - b.yz}));
}

// By the principal axes alone, in the plainest way.
template <class Function>
Sym3 plainly(const Sym3& m, Function&& function) {
  const auto [values, v] = principal(m);
  Mat3 scaled = v;
  Mat3 transposed;
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t k = 0; k < 3; ++k) {
      scaled(i, k) = v(i, k) * function(values[k]);
      transposed(k, i) = v(i, k);
    }
  const Mat3 full = scaled * transposed;
  return {full(0, 0), full(1, 1), full(2, 2), full(0, 1), full(0, 2), full(1, 2)};
}

TEST(Symmetric, PrincipalAxesAreOrthonormalAndGiveTheMatrixBack) {
  Random random(kSymmetricSeed);
  for (int repeat = 0; repeat < 500; ++repeat) {
    const Sym3 m = random_matrix(random, std::pow(10.0, random.uniform(-8, 8)));
    const auto [values, v] = principal(m);
    const double size = std::sqrt(norm_squared(m));
    EXPECT_NEAR(std::abs(determinant(v)), 1, 1e-13) << "seed " << kSymmetricSeed << " repeat " << repeat;
    EXPECT_NEAR(sum_of_squares(v), 3, 1e-13);
    EXPECT_LE(distance(plainly(m, [](double x) { return x; }), m), 1e-14 * size) << "repeat " << repeat;
  }
}

TEST(Symmetric, PrincipalOfWhatIsDiagonalOrOfOneValueOrNothing) {
  EXPECT_EQ(principal({3, 1, 2, 0, 0, 0}).values, (Vec3{3, 1, 2}));
  EXPECT_EQ(principal({}).values, (Vec3{0, 0, 0}));
  Vec3 values = principal({1, 1, 1, 1, 1, 1}).values;  // 0, 0 and 3
  std::sort(values.begin(), values.end());
  EXPECT_NEAR(values[1], 0, 1e-15);
  EXPECT_NEAR(values[2], 3, 1e-15);
}

// Sizes from far inside the series to far outside, the borders between them included.
TEST(Symmetric, SeriesAndAxesAgree) {
  Random random(kSymmetricSeed);
  for (const double size : {1e-9, 1e-4, 0.01, 0.02, 0.025, 0.03, 0.05, 0.06, 0.1, 0.5, 1.0})
    for (int repeat = 0; repeat < 200; ++repeat) {
      const Sym3 strain = random_matrix(random, size);
      const Sym3 stretch = exp(strain);
      EXPECT_LE(distance(stretch, plainly(strain, [](double x) { return std::exp(x); })), 3e-14 * std::exp(3 * size))
          << "seed " << kSymmetricSeed << " size " << size;
      EXPECT_LE(distance(log(stretch), plainly(stretch, [](double x) { return std::log(x); })),
                3e-14 * std::exp(3 * size))
          << "seed " << kSymmetricSeed << " size " << size;
      EXPECT_LE(distance(log(stretch), strain), 1e-13 * std::exp(3 * size))
          << "seed " << kSymmetricSeed << " size " << size;
    }
}

TEST(Symmetric, LogarithmOfWhatHasNoneIsNotANumber) {
  EXPECT_TRUE(std::isnan(log({-1, 1, 1, 0, 0, 0}).xx));
  EXPECT_TRUE(std::isnan(log({std::nan(""), 1, 1, 0, 0, 0}).trace()));
}

}  // namespace
}  // namespace rcb::solvers
