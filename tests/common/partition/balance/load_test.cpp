// Loads, quotas and quotients against big rationals.
#include "common/partition/balance/load.hpp"

#include <cmath>
#include <limits>
#include <numeric>

#include <boost/multiprecision/cpp_int.hpp>
#include <gtest/gtest.h>

#include "common/base/random.hpp"
#include "tests/support/on_ranks.hpp"
#include "tests/support/scenes.hpp"

namespace rcb::partition {
namespace {

using Number = boost::multiprecision::cpp_rational;
using Integer = boost::multiprecision::cpp_int;
using namespace testing;

constexpr std::uint64_t kLoadSeed = 77;

// Is `got` the double nearest to `value`, ties to even?
void expect_nearest(double got, const Number& value) {
  const Number here = abs(Number(got) - value);
  for (const double other : {std::nextafter(got, -HUGE_VAL), std::nextafter(got, HUGE_VAL)}) {
    if (!std::isfinite(other)) continue;
    const Number there = abs(Number(other) - value);
    ASSERT_LE(here, there) << got;
    if (here == there) {
      ASSERT_EQ(std::bit_cast<std::uint64_t>(got) & 1U, 0U) << got;
    }
  }
}

u128 random_wide(Random& random) {
  const u128 value = (u128{random.next()} << 64U) | random.next();
  return value >> random.below(128);
}

TEST(Quotient, IsRoundedOnce) {
  Random random(kLoadSeed);
  for (int i = 0; i < 20000; ++i) {
    const u128 numerator = random_wide(random);
    const u128 denominator = random_wide(random) | 1U;
    expect_nearest(quotient(numerator, denominator), Number(Integer(numerator), Integer(denominator)));
    if (HasFatalFailure()) return;
  }
}

TEST(Quotient, TiesGoToEven) {
  const u128 half = (u128{1} << 53U) + 1;  // between two doubles
  EXPECT_EQ(quotient(half, 1), 0x1p53);
  EXPECT_EQ(quotient(half + 2, 1), 0x1p53 + 4);
  EXPECT_EQ(quotient(half << 60U, u128{1} << 60U), 0x1p53);
  EXPECT_EQ(quotient(0, 5), 0.0);
  EXPECT_EQ(quotient(1, 10), 0.1);
}

TEST(ExactScale, KeepsEveryBitOfNearValues) {
  const ExactScale scale(8.0, 1000);
  EXPECT_EQ(scale(0.0), u128{0});
  EXPECT_EQ(scale(3.0) + scale(5.0), scale(8.0));
  EXPECT_EQ(scale(std::nextafter(1.0, 2.0)) - scale(1.0), scale(0x1p-52));
  EXPECT_GT(scale(0x1p-60), u128{0});
  EXPECT_LE(scale(8.0) * 1000, u128{1} << 127U);
}

TEST(ExactScale, TakesTheWholeRangeOfDoubles) {
  using Limits = std::numeric_limits<double>;
  EXPECT_GT(ExactScale(Limits::denorm_min(), 1)(Limits::denorm_min()), u128{0});
  EXPECT_EQ(ExactScale(Limits::max(), 1)(Limits::denorm_min()), u128{0});
  const ExactScale scale(Limits::max(), std::uint64_t{1} << 48U);
  EXPECT_LT(scale(Limits::max()), u128{1} << 79U);
}

TEST(Quotas, FivePointsInEightParts) {
  EXPECT_EQ(quotas(5, {}, 8), (std::vector<std::uint64_t>{0, 1, 0, 1, 1, 0, 1, 1}));
  EXPECT_EQ(quotas(0, {}, 3), (std::vector<std::uint64_t>{0, 0, 0}));
}

TEST(Quotas, AreTheFloorsOfTheRunningShares) {
  Random random(kLoadSeed);
  for (int i = 0; i < 300; ++i) {
    const int parts = 1 + static_cast<int>(random.below(40));
    const std::uint64_t n = random.next() >> (1 + random.below(63));
    std::vector<double> sizes;
    for (int p = 0; p < parts && i % 3 != 0; ++p) sizes.push_back(random.uniform(1e-3, 10));
    const std::vector<std::uint64_t> got = quotas(n, sizes, parts);
    Number all = 0;
    for (int p = 0; p < parts; ++p) all += sizes.empty() ? Number(1) : Number(sizes[static_cast<std::size_t>(p)]);
    Number running = 0;
    std::uint64_t before = 0;
    for (int p = 0; p < parts; ++p) {
      running += sizes.empty() ? Number(1) : Number(sizes[static_cast<std::size_t>(p)]);
      const Number share = Number(n) * running / all;
      const auto prefix = static_cast<std::uint64_t>(Integer(numerator(share) / denominator(share)));
      ASSERT_EQ(got[static_cast<std::size_t>(p)], prefix - before) << "part " << p << " of " << parts << ", n " << n;
      before = prefix;
    }
    ASSERT_EQ(before, n);
  }
}

TEST(Load, ErrorMeetsAToleranceExactly) {
  // 11 where 10 are due: exactly the double 0.1.
  const LoadSummary summary = summarise_counts({11, 9, 10, 10}, {});
  EXPECT_EQ(summary.error, 0.1);
  EXPECT_EQ(summary.imbalance, 1.1);
  EXPECT_EQ(summary.part_errors, (std::vector<double>{0.1, 0.1, 0, 0}));
  EXPECT_EQ(summary.targets, (std::vector<double>{10, 10, 10, 10}));
}

// In a scale for weights next to the least double there is, loads are subnormal.
TEST(Load, IsRoundedOnceWhereItIsSubnormal) {
  Random random(kLoadSeed);
  std::uint64_t subnormal = 0;
  for (int i = 0; i < 3000; ++i) {
    const std::vector<u128> loads{random_wide(random) >> 3U, random_wide(random) >> 3U, random_wide(random) >> 3U};
    const int scale = 1000 + static_cast<int>(random.below(201));
    const LoadSummary got = summarise_weighted({1, 1, 1}, loads, scale, 0, {});
    const Number unit(1, Integer(1) << scale);
    const Number target = (Integer(loads[0]) + Integer(loads[1]) + Integer(loads[2])) * unit / 3;
    for (std::size_t p = 0; p < loads.size(); ++p) {
      expect_nearest(got.load_values[p], Integer(loads[p]) * unit);
      expect_nearest(got.targets[p], target);
      subnormal += std::fpclassify(got.load_values[p]) == FP_SUBNORMAL ? 1U : 0U;
    }
    if (HasFatalFailure()) return;
  }
  EXPECT_GT(subnormal, 500U);
}

TEST(Load, NoParticles) {
  const LoadSummary summary = summarise_counts({0, 0}, {});
  EXPECT_EQ(summary.error, 0);
  EXPECT_EQ(summary.imbalance, 1);
  EXPECT_EQ(summary.targets, (std::vector<double>{0, 0}));
}

// Rule 6: a weight so far below the greatest that it counts as 0 is told, and so it stays when particles move.
TEST(Load, SaysHowManyWeightsCountAsZero) {
  on_ranks([](comm::Comm& comm) {
    particles::ParticleSet set;
    set.has_weights = true;
    if (comm.rank() == 0) {
      set.resize(5);
      set.weight.assign(std::vector<double>{1e20, 0, 1e-10, 1e-18, 1e-300});  // 124 bits are left of the greatest
      for (std::size_t i = 0; i < 5; ++i) set.id[i] = static_cast<particles::Id>(i);
    }
    const std::vector<std::int32_t> part(set.count(), 0);
    const LoadSummary got = summarise_loads(comm, set.view(), part, {}, 2);
    EXPECT_TRUE(got.weighted);
    EXPECT_EQ(got.weights_as_zero, 2U);
    std::vector<std::uint64_t> slot(set.count() > 0 ? 1 : 0, 2);
    const std::vector<std::int32_t> to(slot.size(), 1);
    const LoadSummary moved = moved_loads(comm, set.view(), got, part, slot, to, {});
    EXPECT_EQ(moved.weights_as_zero, 2U);
    EXPECT_GT(moved.loads[1], 0U);
  });
}

TEST(Load, AgreesWithRationals) {
  for (int weights = 0; weights < testing::kWeights; ++weights)
    for (const bool sized : {false, true}) {
      const std::uint64_t seed = kLoadSeed + static_cast<std::uint64_t>(weights);
      const Scene scene = make_scene(Shape::uniform, static_cast<Weights>(weights), 2, 500, false, seed);
      const std::vector<double> sizes = sized ? std::vector<double>{1, 0.3, 7, 2, 2} : std::vector<double>{};
      constexpr std::size_t kParts = 5;
      const auto part_of_row = [](std::size_t row) { return static_cast<std::int32_t>(mix64(row) % 4); };  // 4 is empty
      const bool weighted = !scene.weight.empty() && weights != static_cast<int>(Weights::equal) &&
                            weights != static_cast<int>(Weights::all_zero);
      std::vector<Number> loads(kParts, 0);
      Number total = 0;
      for (std::size_t i = 0; i < scene.count(); ++i) {
        const Number load = weighted ? Number(scene.weight[i]) : Number(1);
        loads[static_cast<std::size_t>(part_of_row(i))] += load;
        total += load;
      }
      Number size_sum = 0;
      for (std::size_t p = 0; p < kParts; ++p) size_sum += sized ? Number(sizes[p]) : Number(1);
      on_ranks([&](comm::Comm& comm) {
        SCOPED_TRACE(scene.name);
        const Share share = deal(scene, comm.rank(), comm.size(), seed);
        std::vector<std::int32_t> part;
        for (const std::size_t row : share.row) part.push_back(part_of_row(row));
        const LoadSummary got = summarise_loads(comm, share.particles.view(), part, sizes, kParts);
        EXPECT_EQ(got.weighted, weighted);
        Number worst = 0;
        Number most = 0;
        for (std::size_t p = 0; p < kParts; ++p) {
          const Number target = total * (sized ? Number(sizes[p]) : Number(1)) / size_sum;
          const Number off = abs(loads[p] - target) / target;
          expect_nearest(got.part_errors[p], off);
          expect_nearest(got.targets[p], target);
          expect_nearest(got.load_values[p], loads[p]);
          worst = std::max(worst, off);
          most = std::max(most, Number(loads[p] / target));
        }
        expect_nearest(got.error, worst);
        expect_nearest(got.imbalance, most);
      });
      if (HasFatalFailure()) return;
    }
}

}  // namespace
}  // namespace rcb::partition
