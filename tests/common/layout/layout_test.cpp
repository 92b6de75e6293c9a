#include "common/layout/layout.hpp"

#include <limits>

#include <gtest/gtest.h>

namespace rcb::layout {
namespace {

TEST(Layout, PartsOfRanks) {
  for (int parts = 1; parts <= 20; ++parts) {
    for (int ranks = 1; ranks <= 20; ++ranks) {
      EXPECT_EQ(part_begin(0, parts, ranks), 0);
      EXPECT_EQ(part_begin(ranks, parts, ranks), parts);
      for (int part = 0; part < parts; ++part) {
        const int rank = rank_of_part(part, parts, ranks);
        EXPECT_LE(part_begin(rank, parts, ranks), part);
        EXPECT_LT(part, part_begin(rank + 1, parts, ranks));
      }
    }
  }
  EXPECT_EQ(rank_of_part(1048575, 1048576, 1000000), 999999);
  EXPECT_EQ(row_begin(999999, std::uint64_t{1} << 60U, 1000000), 1152920351685342369U);
}

// Rows of up to 2^64 - 1 are divided without overflow, and every one is somebody's.
TEST(Layout, RowsOfRanks) {
  for (const std::uint64_t count :
       {std::uint64_t{0}, std::uint64_t{1}, std::uint64_t{10}, std::numeric_limits<std::uint64_t>::max()})
    for (const int ranks : {1, 3, 8}) {
      EXPECT_EQ(row_begin(0, count, ranks), 0U);
      EXPECT_EQ(row_begin(ranks, count, ranks), count);
      for (int rank = 0; rank < ranks; ++rank) {
        const std::uint64_t rows = row_begin(rank + 1, count, ranks) - row_begin(rank, count, ranks);
        EXPECT_LE(rows - count / static_cast<std::uint64_t>(ranks), 1U);
      }
    }
}

}  // namespace
}  // namespace rcb::layout
