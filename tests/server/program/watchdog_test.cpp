// The watchdog, over an engine whose order can be held up.
#include "server/program/watchdog.hpp"

#include <atomic>
#include <chrono>
#include <thread>

#include <gtest/gtest.h>

#include "tests/support/forwarding_comm.hpp"
#include "tests/support/self_comm.hpp"

namespace rcb::server {
namespace {

using wire::Json;

// Stands still in a collective until it is told to go on.
class HeldComm final : public testing::ForwardingComm {
 public:
  using ForwardingComm::ForwardingComm;
  std::atomic<bool> held = false;

 protected:
  void before() override {
    while (held) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
};

void order(ranks::EngineLoop& loop, std::uint64_t number, Json request, double deadline_seconds) {
  ranks::EngineOrder out;
  out.number = number;
  out.request = std::move(request);
  out.deadline_seconds = deadline_seconds;
  ASSERT_TRUE(loop.push(std::move(out)));
}

TEST(Watchdog, BarksOnceAnOrderIsFarPastItsDeadline) {
  testing::SelfComm self;
  HeldComm comm(self);
  ranks::EngineLoop loop(10);
  Watchdog watchdog(loop, 3 * net::kTickSeconds);
  const SteadyClock clock;
  service::Service service(comm, clock);
  EXPECT_FALSE(watchdog.tick()) << "nothing runs";
  comm.held = true;
  order(loop, 1, {{"command", "scene.create"}, {"scene", "a"}, {"parts", 2}, {"dims", 3}}, 60);
  order(loop, 2, {{"command", "assign"}, {"scene", "a"}}, net::kTickSeconds);
  order(loop, 3, {{"command", "shutdown"}}, 60);
  std::thread engine([&] { loop.run(service); });
  // The second order asks the ranks whether it is late already, and stands still there.
  while (loop.number_running() != 2) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  int ticks = 0;
  while (!watchdog.tick()) ASSERT_LT(++ticks, 100);
  EXPECT_EQ(loop.number_running(), 2U);
  EXPECT_GE(ticks * net::kTickSeconds, 4 * net::kTickSeconds);
  comm.held = false;
  engine.join();
  EXPECT_FALSE(watchdog.tick()) << "nothing runs any more";
}

}  // namespace
}  // namespace rcb::server
