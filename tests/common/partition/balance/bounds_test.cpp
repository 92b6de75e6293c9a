// Bounds over ranks against those of all values in one place.
#include "common/partition/balance/bounds.hpp"

#include <cmath>

#include <gtest/gtest.h>

#include "common/base/random.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::partition {
namespace {

// More of everything than one message holds.
TEST(AllMinMax, TakesTheBoundsOfAllRanks) {
  constexpr std::size_t kBoxes = 1000;
  testing::on_ranks([](comm::Comm& comm) {
    const auto box_of = [](int rank, std::size_t k) {
      Random random(mix64(1000 * k + static_cast<std::uint64_t>(rank)));
      geometry::Box box;
      if (random.below(3) == 0) return box;  // empty on this rank
      for (std::size_t a = 0; a < 3; ++a) {
        box.lo[a] = random.uniform(-1, 1) * std::pow(10.0, random.uniform(-300, 300));
        box.hi[a] = box.lo[a] + std::abs(box.lo[a]);
      }
      return box;
    };
    const auto integer = [](int rank, std::size_t k) { return mix64(k + 7 * static_cast<std::uint64_t>(rank)); };
    AllMinMax all;
    for (std::size_t k = 0; k < kBoxes; ++k) {
      all.add(box_of(comm.rank(), k), 3);
      all.add(integer(comm.rank(), k), integer(comm.rank(), k));
    }
    EXPECT_EQ(all.reduce(comm), 2U);
    for (std::size_t k = 0; k < kBoxes; ++k) {
      geometry::Box box;
      std::uint64_t least = ~std::uint64_t{0};
      std::uint64_t most = 0;
      for (int r = 0; r < comm.size(); ++r) {
        box.extend(box_of(r, k));
        least = std::min(least, integer(r, k));
        most = std::max(most, integer(r, k));
      }
      geometry::Box got_box;
      std::uint64_t got_least = 0;
      std::uint64_t got_most = 0;
      all.take(got_box, 3);
      all.take(got_least, got_most);
      EXPECT_TRUE(got_box == box) << k;
      EXPECT_EQ(got_least, least);
      EXPECT_EQ(got_most, most);
    }
  });
}

}  // namespace
}  // namespace rcb::partition
