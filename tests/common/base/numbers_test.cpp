// Narrowing, checks, and random numbers that must be the same on every machine.
#include <cstdint>
#include <limits>

#include <gtest/gtest.h>

#include "common/base/check.hpp"
#include "common/base/narrow.hpp"
#include "common/base/random.hpp"

namespace rcb {
namespace {

TEST(Narrow, KeepsWhatFits) {
  EXPECT_EQ(narrow<int>(std::int64_t{-2147483648}), std::numeric_limits<int>::min());
  EXPECT_EQ(narrow<std::uint8_t>(255), 255);
  EXPECT_EQ(narrow<std::int64_t>(std::uint64_t{1} << 62U), std::int64_t{1} << 62U);
}

TEST(NarrowDeathTest, CatchesWhatDoesNot) {
  EXPECT_DEATH(static_cast<void>(narrow<int>(std::int64_t{2147483648})), "integer out of range");
  EXPECT_DEATH(static_cast<void>(narrow<std::uint64_t>(-1)), "integer out of range");
  EXPECT_DEATH(static_cast<void>(narrow<std::int64_t>(std::uint64_t{1} << 63U)), "integer out of range");
  EXPECT_DEATH(static_cast<void>(narrow<std::uint8_t>(256)), "integer out of range");
}

TEST(CheckDeathTest, SaysWhoAndWhat) {
  EXPECT_DEATH(
      {
        set_check_context("rank 3 of 8");
        RCB_CHECK(1 + 1 == 3, "sums");
      },
      "rank 3 of 8: .*numbers_test.cpp:[0-9]+: RCB_CHECK\\(1 \\+ 1 == 3\\) failed: sums");
  RCB_CHECK(true, "never said");
}

TEST(Random, IsSplitMix64) {
  // The published generator's first outputs for the seed 1234567.
  Random random(1234567);
  EXPECT_EQ(random.next(), 6457827717110365317U);
  EXPECT_EQ(random.next(), 3203168211198807973U);
  EXPECT_EQ(random.next(), 9817491932198370423U);
  EXPECT_EQ(random.next(), 4593380528125082431U);
  EXPECT_EQ(mix64(0), 0xE220A8397B1DCDAFU);
}

TEST(Random, StaysInItsRange) {
  Random random(1);
  double least = 1, most = 0;
  for (int i = 0; i < 100000; ++i) {
    const double u = random.uniform();
    ASSERT_GE(u, 0);
    ASSERT_LT(u, 1);
    least = std::min(least, u);
    most = std::max(most, u);
    const double v = random.uniform(-3, 5);
    ASSERT_GE(v, -3);
    ASSERT_LE(v, 5);
    ASSERT_LT(random.below(7), 7U);
  }
  EXPECT_LT(least, 0.001);
  EXPECT_GT(most, 0.999);
  EXPECT_EQ(random.below(1), 0U);
  EXPECT_LT(random.below(std::numeric_limits<std::uint64_t>::max()), std::numeric_limits<std::uint64_t>::max());
}

TEST(Random, SeedsDiffer) {
  Random a(1), b(1), c(2);
  EXPECT_EQ(a.next(), b.next());
  EXPECT_NE(a.next(), c.next());
}

}  // namespace
}  // namespace rcb
