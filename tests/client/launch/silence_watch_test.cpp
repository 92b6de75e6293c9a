// When a dead service is started again, and when a silent one is given up: by a clock of the test's own.
#include "client/launch/silence_watch.hpp"

#include <set>

#include <gtest/gtest.h>

namespace rcb::launch {
namespace {

TEST(SilenceWatch, IsCountedFromTheFirstQuestionLeftOpen) {
  SilenceWatch silence(10, 30);
  silence.begin(0, 60);
  EXPECT_EQ(silence.due(), 10);
  EXPECT_FALSE(silence.record_probe(true, 10, 10));
  EXPECT_FALSE(silence.record_probe(false, 20, 25));
  EXPECT_FALSE(silence.record_probe(false, 35, 40));
  EXPECT_FALSE(silence.record_probe(true, 45, 46));  // it was only busy
  EXPECT_FALSE(silence.record_probe(false, 50, 55));
  EXPECT_FALSE(silence.record_probe(false, 65, 70));
  EXPECT_TRUE(silence.record_probe(false, 80, 85));
  EXPECT_EQ(silence.silent_seconds(85), 35);
}

TEST(SilenceWatch, ASupervisorThatSleptAsksAgainBeforeItJudges) {
  SilenceWatch silence(10, 30);
  silence.begin(0, 0);
  EXPECT_FALSE(silence.record_probe(true, 10, 10));
  EXPECT_FALSE(silence.record_probe(false, 1000, 1005)) << "nobody was asked meanwhile";
  EXPECT_FALSE(silence.record_probe(false, 1015, 5000)) << "two questions are few";
  EXPECT_FALSE(silence.record_probe(true, 5010, 5010));
}

TEST(SilenceWatch, AStartMayTakeItsTime) {
  SilenceWatch silence(10, 30);
  silence.begin(0, 100);
  for (double now = 10; now < 100; now += 10) ASSERT_FALSE(silence.record_probe(false, now, now)) << now;
  EXPECT_TRUE(silence.record_probe(false, 100, 100));
}

}  // namespace
}  // namespace rcb::launch
