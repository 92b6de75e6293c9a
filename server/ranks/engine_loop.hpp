// EngineLoop: a rank's engine thread. It sleeps on a bounded queue and executes one order after another; it alone
// calls MPI and never touches a socket.
//
// Invariants
// 1. Orders of one scene are executed in the order of push(). So are those of different scenes, but for a command that
//    gives way (server/api/commands.hpp): where it asks whether to go on, what waits for other scenes is executed
//    first.
// 2. Every rank's queue holds the same orders, besides rank 0's own, and every rank executes them in the same sequence.
// 3. The order {"command":"shutdown"} ends run() on every rank; nothing is executed after it.
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <mutex>
#include <utility>
#include <vector>

#include "server/service/service.hpp"

namespace rcb::ranks {

struct EngineOrder {
  std::uint64_t number = 0;  // 1, 2, ...
  wire::Json request;
  std::vector<service::PushSlice> slices;
  double received_seconds = 0;
  double deadline_seconds = 60;
  std::chrono::steady_clock::time_point ordered = std::chrono::steady_clock::now();
  std::shared_ptr<const std::atomic<bool>> cancelled;  // nobody waits for the answer any more; may be null
  // Called on the engine thread when it is done; may be empty.
  std::function<void(service::Response)> done;
};

class EngineLoop {
 public:
  // Called on the engine thread; may be empty.
  struct Handlers {
    std::function<void(service::Spare)> spare;  // with memory for a scene's next slice (service.hpp)
    std::function<void()> executed;             // after every order
  };
  explicit EngineLoop(std::size_t capacity, Handlers handlers = {})
      : capacity_(capacity), handlers_(std::move(handlers)) {}

  // Any thread. False if the queue is full, which the coordinator must have prevented.
  [[nodiscard]] bool push(EngineOrder order);
  // Engine thread. Returns after the order `shutdown`.
  void run(service::Service& service);

  // What is being executed now; 0 if nothing.
  std::uint64_t number_running() const { return number_running_.load(std::memory_order_relaxed); }
  double deadline_running_seconds() const { return deadline_running_.load(std::memory_order_relaxed); }

 private:
  // What an order that gives way gives way to.
  class Others;
  EngineOrder next();
  void execute(service::Service& service, EngineOrder order);

  const std::size_t capacity_;
  Handlers handlers_;
  std::mutex mutex_;
  std::condition_variable filled_;
  std::deque<EngineOrder> queue_;
  std::atomic<std::uint64_t> number_running_ = 0;
  std::atomic<double> deadline_running_ = 0;
};

}  // namespace rcb::ranks
