// When a dead service is started again, and when a silent one is given up: by a clock of the test's own.
#include "client/launch/restarts.hpp"

#include <set>

#include <gtest/gtest.h>

namespace rcb::launch {
namespace {

TEST(Silence, IsCountedFromTheFirstQuestionLeftOpen) {
  Silence silence(10, 30);
  silence.begin(0, 60);
  EXPECT_EQ(silence.due(), 10);
  EXPECT_FALSE(silence.heard(true, 10, 10));
  EXPECT_FALSE(silence.heard(false, 20, 25));
  EXPECT_FALSE(silence.heard(false, 35, 40));
  EXPECT_FALSE(silence.heard(true, 45, 46));  // it was only busy
  EXPECT_FALSE(silence.heard(false, 50, 55));
  EXPECT_FALSE(silence.heard(false, 65, 70));
  EXPECT_TRUE(silence.heard(false, 80, 85));
  EXPECT_EQ(silence.silent_seconds(85), 35);
}

TEST(Silence, ASupervisorThatSleptAsksAgainBeforeItJudges) {
  Silence silence(10, 30);
  silence.begin(0, 0);
  EXPECT_FALSE(silence.heard(true, 10, 10));
  EXPECT_FALSE(silence.heard(false, 1000, 1005)) << "nobody was asked meanwhile";
  EXPECT_FALSE(silence.heard(false, 1015, 5000)) << "two questions are few";
  EXPECT_FALSE(silence.heard(true, 5010, 5010));
}

TEST(Silence, AStartMayTakeItsTime) {
  Silence silence(10, 30);
  silence.begin(0, 100);
  for (double now = 10; now < 100; now += 10) ASSERT_FALSE(silence.heard(false, now, now)) << now;
  EXPECT_TRUE(silence.heard(false, 100, 100));
}

}  // namespace
}  // namespace rcb::launch
