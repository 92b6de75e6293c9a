// EngineLoop: a rank's engine thread. It sleeps on a bounded queue and executes one order after another. It is the only
// thread that calls MPI, and never touches a socket.
//
// Invariants
// 1. Orders are executed in the order of push(), except with a command that gives way (server/api/commands.hpp): each
//    time that command asks whether to go on, the orders behind it are executed first. While it is unfinished, the
//    caller of push() must not add an order that has to wait for its end, such as one for all ranks on the same scene.
//    A second command that gives way, executed in the middle of the first, executes what is behind both.
// 2. Every rank's queue holds the same orders, in the same sequence, apart from those for rank 0 alone. So collectives
//    match.
// 3. The order {"command":"shutdown"} ends run() on every rank; nothing is executed after it.
// 4. MPI may report a message as sent while part of it is still in its own buffers, and sends the rest only when it is
//    called. So an idle engine calls it for two minutes more, at growing intervals.
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

#include "server/api/commands.hpp"
#include "server/service/service.hpp"

namespace rcb::ranks {

struct EngineOrder {
  std::uint64_t number = 0;  // 1, 2, ...
  wire::Json request;
  std::vector<service::PushSlice> slices;
  double received_seconds = 0;
  double deadline_seconds = 60;
  std::chrono::steady_clock::time_point ordered = std::chrono::steady_clock::now();
  std::shared_ptr<const std::atomic<bool>> cancelled;  // set once nobody waits for the answer; may be null
  // Called on the engine thread when the order is done; may be empty.
  std::function<void(service::Response)> done;
};

class EngineLoop {
 public:
  // Called on the engine thread; may be empty.
  struct Handlers {
    std::function<void()> executed;  // after every order
    std::function<void()> progress;  // lets MPI send what it still holds
  };
  explicit EngineLoop(std::size_t capacity, Handlers handlers = {})
      : capacity_(capacity), handlers_(std::move(handlers)) {}

  // Any thread. False if the queue is full; the coordinator must make sure that this never happens.
  [[nodiscard]] bool push(EngineOrder order);
  // Engine thread. Returns after the order `shutdown`.
  void run(service::Service& service);

  // The number of the order being executed; 0 if none is.
  std::uint64_t number_running() const { return number_running_.load(std::memory_order_relaxed); }
  double deadline_running_seconds() const { return deadline_running_.load(std::memory_order_relaxed); }

 private:
  struct Queued {
    EngineOrder order;
    const api::CommandInfo* command;  // null: an internal command, such as push
  };
  // The orders queued behind a running command that gives way.
  class OrdersBehind;
  // No deadline: an idle engine may sleep for ever. The I/O thread ends the process if the other ranks are lost.
  template <typename Filled>
  void wait(std::unique_lock<std::mutex>& lock, const Filled& filled);
  Queued next();
  std::optional<Queued> next_up_to(std::uint64_t newest);
  void execute(service::Service& service, Queued queued);

  const std::size_t capacity_;
  Handlers handlers_;
  std::mutex mutex_;
  std::condition_variable filled_;
  std::deque<Queued> queue_;
  std::atomic<std::uint64_t> number_running_ = 0;
  std::atomic<double> deadline_running_ = 0;
};

}  // namespace rcb::ranks
