#include "common/files/side_thread.hpp"

#include <atomic>
#include <future>
#include <memory>
#include <stdexcept>
#include <system_error>
#include <vector>

#include <gtest/gtest.h>

namespace rcb {
namespace {

// Runs until the job before it has ended.
void settle(SideThread& thread) {
  std::promise<void> done;
  ASSERT_TRUE(thread.post([] {}, [&done] { done.set_value(); }).ok());
  done.get_future().wait();
}

TEST(SideThread, RunsJobsInTurnAndSaysWhenEachHasEnded) {
  std::vector<int> run;
  SideThread thread(1000);
  for (int k = 0; k < 5; ++k)
    ASSERT_TRUE(thread.post([&run, k] { run.push_back(k); }, [&run, k] { run.push_back(10 + k); }).ok());
  settle(thread);
  EXPECT_EQ(run, (std::vector<int>{0, 10, 1, 11, 2, 12, 3, 13, 4, 14}));
}

TEST(SideThread, RefusesWhatDoesNotFitAndGoesOnAfterAFault) {
  SideThread thread(1000);
  std::promise<void> moves;
  ASSERT_TRUE(thread.post([&moves] { moves.get_future().wait(); }, {}, 600).ok());
  EXPECT_EQ(thread.post([] {}, {}, 500).code(), Code::busy);
  EXPECT_TRUE(thread.post([] { throw std::runtime_error("a fault"); }, {}, 400).ok());
  std::size_t small = 0;
  while (thread.post([] {}).ok() && small < 2 * SideThread::kJobsMax) ++small;
  EXPECT_LT(small, SideThread::kJobsMax);
  std::atomic<bool> removed = false;
  thread.post_surely([&removed] { removed = true; });
  moves.set_value();
  std::promise<void> done;
  while (!thread.post([] {}, [&done] { done.set_value(); }).ok()) std::this_thread::yield();
  done.get_future().wait();
  EXPECT_TRUE(removed);
}

TEST(SideThread, DoesWhatWaitsBeforeItEnds) {
  int run = 0;
  {
    SideThread thread(1000);
    for (int k = 0; k < 100; ++k) ASSERT_TRUE(thread.post([&run] { ++run; }).ok());
  }
  EXPECT_EQ(run, 100);
}

TEST(SideThread, ItsEndWaitsForNoJobThatHangs) {
  struct Outcome {
    std::promise<void> moves;
    std::promise<void> ended;
    std::atomic<int> heard = 0;
  };
  const auto outcome = std::make_shared<Outcome>();
  std::weak_ptr<int> token;
  {
    const auto held = std::make_shared<int>(1);
    token = held;
    SideThread thread(1000);
    const auto hang = [outcome] {
      outcome->moves.get_future().wait();
      outcome->ended.set_value();
    };
    ASSERT_TRUE(thread.post(hang, [outcome] { ++outcome->heard; }).ok());
    ASSERT_TRUE(thread.post([] {}, [outcome, held] { ++outcome->heard; }).ok());
  }
  EXPECT_TRUE(token.expired()) << "who waits for a job's end hears at once that it won't come";
  outcome->moves.set_value();
  outcome->ended.get_future().wait();
  EXPECT_EQ(outcome->heard, 0) << "the owner has gone";
}

TEST(SideThread, WithoutAThreadEachJobIsRefusedUntilThereIsOne) {
  int asked = 0;
  SideThread thread(1000, [&asked](SideThread::Job run) {
    if (++asked < 3) throw std::system_error(EAGAIN, std::generic_category());
    return std::thread(std::move(run));
  });
  const Status refused = thread.post([] {});
  EXPECT_EQ(refused.code(), Code::unavailable);
  EXPECT_NE(refused.hint().find("limit"), std::string::npos);
  settle(thread);
  EXPECT_EQ(asked, 3);
}

}  // namespace
}  // namespace rcb
