// Credits: no rank gets more orders than its queue holds, whatever the ranks say and when.
#include "server/net/control/credits.hpp"

#include <vector>

#include <gtest/gtest.h>

#include "common/base/random.hpp"

namespace rcb::net {
namespace {

TEST(Credits, TheSlowestRankCounts) {
  Credits credits(3, 4, 1000);
  for (int i = 0; i < 4; ++i) {
    ASSERT_TRUE(credits.room(10));
    credits.sent(10);
  }
  EXPECT_FALSE(credits.room(10));
  credits.executed(1, 4);
  credits.executed(2, 4);
  EXPECT_FALSE(credits.room(10));
  credits.executed(3, 1);
  EXPECT_TRUE(credits.room(10));
}

TEST(Credits, BytesCountButNeverKeepBackASingleOrder) {
  Credits credits(1, 100, 1000);
  EXPECT_TRUE(credits.room(5000));
  credits.sent(5000);
  EXPECT_FALSE(credits.room(1));
  credits.executed(1, 1);
  EXPECT_TRUE(credits.room(1));
}

TEST(Credits, OneRankNeedsNone) {
  Credits credits(0, 1, 1);
  for (int i = 0; i < 10; ++i) {
    EXPECT_TRUE(credits.room(100));
    credits.sent(100);
  }
}

TEST(Credits, NoQueueOverflowsAndNothingIsHeldUpForEver) {
  constexpr std::uint64_t kOrders = 16;
  const std::uint64_t seed = 20250611;
  SCOPED_TRACE(seed);
  Random random(seed);
  Credits credits(3, kOrders, 1 << 20);
  std::vector<std::uint64_t> executed(3, 0);
  std::uint64_t sent = 0;
  for (int i = 0; i < 20000; ++i) {
    const std::size_t rank = random.below(3);
    if (random.below(2) == 0 && executed[rank] < sent) ++executed[rank];
    if (random.below(4) == 0) credits.executed(static_cast<int>(rank) + 1, executed[rank]);
    if (random.below(50) == 0) {  // more than was sent is not believed
      credits.executed(1, executed[0] + 1000);
      executed[0] = sent;
    }
    if (!credits.room(1)) continue;
    credits.sent(1);
    ++sent;
    for (const std::uint64_t done : executed) ASSERT_LE(sent - done, kOrders);
  }
  EXPECT_GT(sent, 1000U);
}

}  // namespace
}  // namespace rcb::net
