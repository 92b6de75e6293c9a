// Every length and place, so that each width of instruction and what is left over has its turn.
#include "server/service/inside.hpp"

#include <limits>
#include <vector>

#include <gtest/gtest.h>

namespace rcb::service {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

TEST(Inside, OneValueOutsideIsSeenWhereverItStands) {
  for (std::size_t count = 0; count <= 70; ++count) {
    std::vector<double> values(count, 0.5);
    EXPECT_TRUE(all_inside(values.data(), count, 0, 1)) << count;
    EXPECT_TRUE(all_inside(values.data(), count, -kInfinity, kInfinity)) << count;
    for (std::size_t at = 0; at < count; ++at) {
      for (const double outside : {0.0, -0.0, 1.0, -3.0, 7.0, kInfinity, -kInfinity, kNan, -kNan}) {
        values[at] = outside;
        EXPECT_FALSE(all_inside(values.data(), count, 0, 1)) << outside << " at " << at << " of " << count;
      }
      for (const double never : {kInfinity, -kInfinity, kNan}) {
        values[at] = never;
        EXPECT_FALSE(all_inside(values.data(), count, -kInfinity, kInfinity)) << never << " at " << at;
      }
      values[at] = 0.5;
    }
  }
}

}  // namespace
}  // namespace rcb::service
