// Numbers of parts below and above what registers hold, every length and place, so that each width of instruction and
// what is left over has its turn.
#include "common/cuts/regions.hpp"

#include <limits>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "common/base/random.hpp"

namespace rcb::cuts {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr std::int32_t kFirst = 70;

// Part kFirst + p is from p to p + 1 along y, and everywhere else.
Regions slabs(std::size_t parts) {
  std::vector<geometry::Box> boxes(parts, geometry::Box::unbounded());
  for (std::size_t p = 0; p < parts; ++p) {
    boxes[p].lo[1] = p == 0 ? -kInfinity : static_cast<double>(p);
    boxes[p].hi[1] = p + 1 == parts ? kInfinity : static_cast<double>(p + 1);
  }
  return {kFirst, boxes};
}

TEST(Regions, OneValueOutsideIsSeenWhereverItStands) {
  for (const std::size_t parts : {1U, 2U, 4U, 5U, 8U, 9U, 33U}) {
    const Regions regions = slabs(parts);
    for (std::size_t count = 0; count <= particles::kBlock; ++count) {
      std::vector<double> values;
      std::vector<std::int32_t> part;
      for (std::size_t i = 0; i < count; ++i) {
        const std::uint64_t p = mix64(i) % parts;
        part.push_back(kFirst + static_cast<std::int32_t>(p));
        values.push_back(static_cast<double>(p) + 0.5);
      }
      EXPECT_EQ(regions.outside(1, values, part.data()), 0U);
      for (std::size_t at = 0; at < count; ++at) {
        const double kept = values[at];
        const double lo = kept - 0.5;
        const bool first = part[at] == kFirst;
        const bool last = part[at] + 1 == kFirst + static_cast<std::int32_t>(parts);
        const auto check = [&](double value, bool outside) {
          values[at] = value;
          EXPECT_EQ(regions.outside(1, values, part.data()), outside ? std::uint64_t{1} << at : 0U)
              << fmt::format("{} at {} of {}, {} parts", value, at, count, parts);
        };
        check(lo, !first);
        check(lo - 7, !first);
        check(lo + 1, !last);
        check(lo + 7, !last);
        for (const double never : {kInfinity, -kInfinity, kNan, -kNan}) check(never, true);
        values[at] = kept;
      }
    }
  }
}

TEST(Regions, ARangeIsHeldStrictly) {
  const Regions regions = slabs(3);
  EXPECT_TRUE(regions.hold(1, kFirst + 1, {1.25, 1.75}));
  EXPECT_FALSE(regions.hold(1, kFirst + 1, {1, 1.75}));
  EXPECT_FALSE(regions.hold(1, kFirst + 1, {1.25, 2}));
  EXPECT_TRUE(regions.hold(1, kFirst, {-1e300, 0.5}));
  EXPECT_FALSE(regions.hold(1, kFirst, {-kInfinity, 0.5}));
  EXPECT_TRUE(regions.hold(0, kFirst + 1, {-5, 5}));
  EXPECT_FALSE(regions.hold(0, kFirst + 1, particles::Range::everything()));
}

}  // namespace
}  // namespace rcb::cuts
