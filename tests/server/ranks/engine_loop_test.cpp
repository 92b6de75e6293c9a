// The sequence in which orders are executed: that of their numbers, but for commands that may last, which give way to
// other scenes.
#include "server/ranks/engine_loop.hpp"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include "common/base/random.hpp"
#include "server/api/commands.hpp"
#include "tests/support/on_ranks.hpp"
#include "tests/support/self_comm.hpp"

namespace rcb::testing {
namespace {

using ranks::EngineLoop;
using ranks::EngineOrder;
using wire::Json;

constexpr std::uint64_t kCount = 300;

// A rank's queue, filled as rank 0 fills it: what rank 0 executes alone has a number and comes to no other, and what
// must wait for the end of a command that may last is added after it.
class Queue {
 public:
  Queue(comm::Comm& comm, EngineLoop& loop) : comm_(comm), loop_(loop) {}

  void add(Json request, std::vector<service::PushSlice> slices = {}) {
    const std::string name = request["command"];
    const api::CommandInfo* command = api::find_command(name);
    ++number_;
    const bool root = command != nullptr && command->runs_on == api::RunsOn::root;
    if (comm_.rank() != 0 && root) return;
    const bool lasts = name == "shutdown" || (command != nullptr && command->gives_way);
    if (!root) {
      std::unique_lock lock(mutex_);
      ended_.wait(lock, [&] { return !lasting_ || (!lasts && request.value("scene", Json()) != *lasting_); });
      if (lasts) lasting_ = request["scene"];
    }
    EngineOrder order;
    order.number = number_;
    const bool wrong = request.contains("scene") && !request["scene"].is_string();
    const std::string text = name + " " + (wrong ? "?" : request.value("scene", "-"));
    order.done = [this, text, wrong, lasts](const service::Response& response) {
      done.push_back(text);
      if (lasts) {
        const std::lock_guard lock(mutex_);
        lasting_.reset();
        ended_.notify_one();
      }
      if (comm_.rank() != 0) return;
      EXPECT_EQ(response.status.ok(), !wrong) << text << ": " << response.status.message();
    };
    order.request = std::move(request);
    if (comm_.rank() == 0) order.slices = std::move(slices);
    EXPECT_TRUE(loop_.push(std::move(order)));
  }
  void add(const std::string& command, const std::string& scene) { add({{"command", command}, {"scene", scene}}); }

  void push_step(const std::string& scene, std::int64_t step) {
    Random random(static_cast<std::uint64_t>(step));
    service::PushSlice slice{.count = kCount, .arrays = {}};
    for (const char* axis : {"x", "y", "z"}) {
      wire::Array array{axis, "<f8", {kCount}, {}};
      std::vector<double> values(kCount);
      for (double& value : values) value = random.uniform();
      array.bytes.assign(std::as_bytes(std::span(values)));
      slice.arrays.push_back(std::move(array));
    }
    std::vector<service::PushSlice> slices;
    slices.push_back(std::move(slice));
    add({{"command", "push"},
         {"scene", scene},
         {"step", step},
         {"n", kCount},
         {"blocks", Json::array({{{"seat", 0}, {"n", kCount}, {"way", "endpoint"}, {"dtype", "<f8"}}})}},
        std::move(slices));
  }

  std::vector<std::string> done;

 private:
  comm::Comm& comm_;
  EngineLoop& loop_;
  std::uint64_t number_ = 0;
  std::mutex mutex_;
  std::condition_variable ended_;
  std::optional<Json> lasting_;  // the scene of a command that may last and hasn't ended
};

TEST(EngineLoop, WhatMayLastGivesWay) {
  on_ranks([](comm::Comm& comm) {
    EngineLoop loop(100);
    Queue queue(comm, loop);
    for (const char* scene : {"long", "other"}) {
      queue.add({{"command", "scene.create"}, {"scene", scene}, {"parts", 4}, {"dims", 3}});
      queue.push_step(scene, 0);
    }
    queue.add("compare", "long");
    queue.add("cuts", "long");
    queue.push_step("other", 1);
    queue.add({{"command", "scene.create"}, {"scene", "third"}, {"parts", 2}, {"dims", 3}});
    queue.push_step("third", 0);
    queue.add("cuts", "third");
    queue.add({{"command", "assign"}, {"scene", 7}});  // refused, and no more
    std::thread at_its_end([&] { queue.add("shutdown", ""); });
    const SteadyClock clock;
    service::Service service(comm, clock);
    loop.run(service);
    at_its_end.join();
    std::vector<std::string> expected{"scene.create long", "push long",  "scene.create other", "push other",
                                      "cuts long",         "push other", "scene.create third", "push third",
                                      "cuts third",        "assign ?",   "compare long",       "shutdown "};
    if (comm.rank() != 0) std::erase_if(expected, [](const std::string& one) { return one.starts_with("cuts"); });
    EXPECT_EQ(queue.done, expected);
  });
}

// What MPI has taken for sent may still be here, and others wait for it.
TEST(EngineLoop, AnIdleOneCallsMpiAllTheSame) {
  std::atomic<int> calls = 0;
  EngineLoop loop(10, {.progress = [&] { ++calls; }});
  testing::SelfComm comm;
  const SteadyClock clock;
  service::Service service(comm, clock);
  std::thread engine([&] { loop.run(service); });
  for (const int more : {5, 10}) {
    const int before = calls;
    for (int k = 0; k < 20'000 && calls < before + more; ++k) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    EXPECT_GE(calls, before + more);
    EXPECT_TRUE(loop.push({.number = 1, .request = {{"command", more == 10 ? "shutdown" : "scene.list"}}}));
  }
  engine.join();
}

// The ranks' queues are filled while they run, each at its own pace.
TEST(EngineLoop, EveryRankExecutesTheSameSequence) {
  std::mutex mutex;
  std::vector<std::vector<std::string>> all;
  on_ranks([&](comm::Comm& comm) {
    EngineLoop loop(1000);
    Queue queue(comm, loop);
    const SteadyClock clock;
    std::thread filler([&] {
      Random pace(static_cast<std::uint64_t>(comm.rank()) + 11);
      Random what(5);
      for (const char* scene : {"a", "b", "c", "d"}) {
        queue.add({{"command", "scene.create"}, {"scene", scene}, {"parts", 5}, {"dims", 3}});
        queue.push_step(scene, 0);
      }
      for (std::int64_t k = 1; k < 120; ++k) {
        const std::string scene(1, static_cast<char>('a' + what.below(4)));
        const std::uint64_t kind = what.below(6);
        if (kind < 2)
          queue.push_step(scene, k);
        else
          queue.add(kind == 2 ? "compare" : kind == 3 ? "quality" : kind == 4 ? "assign" : "cuts", scene);
        if (pace.below(3) == 0) std::this_thread::sleep_for(std::chrono::microseconds(pace.below(400)));
      }
      queue.add("shutdown", "");
    });
    service::Service service(comm, clock);
    loop.run(service);
    filler.join();
    std::erase_if(queue.done, [](const std::string& one) { return one.starts_with("cuts"); });
    const std::lock_guard lock(mutex);
    all.push_back(queue.done);
    if (static_cast<int>(all.size()) < comm.size()) return;
    for (const auto& one : all) EXPECT_EQ(one, all.front());
    all.clear();
  });
}

}  // namespace
}  // namespace rcb::testing
