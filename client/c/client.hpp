// rcbd_client: a client, whose calls take turns, and the thread that makes the steps that were begun.
//
// Invariants
// 1. What a C++ Client or Scene is asked, it is asked by who holds the turn; so they belong to one thread at a time.
// 2. rcbd_interrupt() and rcbd_cancel() only set atomic values, which calls ask for while they wait.
// 3. The thread runs ops in the order in which they were begun. An op lives until it is done: its last holder waits.
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <thread>

#include "client/c/handle.hpp"
#include "client/include/rcbd/rcbd.h"
#include "client/lib/client.hpp"
#include "common/wire/limits.hpp"

namespace rcb::c {

// A deadline must be above 0.
Status check_deadline(double seconds);

// What is left of a call's time, of which waiting for its turn is a part.
class Left {
 public:
  explicit Left(double seconds = wire::kDeadlineSecondsDefault);
  double seconds() const;  // above 0, as a deadline must be

 private:
  std::chrono::steady_clock::time_point until_;
};

// Lets one call after another go on.
class Turns {
 public:
  // Errors: busy, after so many seconds; interrupted, where `stop` says so meanwhile.
  Status take(double seconds, const std::function<bool()>& stop);
  void take();
  void give();

 private:
  std::mutex mutex_;
  std::condition_variable given_;
  bool taken_ = false;
};

// What rcbd_interrupt() asks for: the end of the calls under way, or else of the next one that waits.
class Interrupts {
 public:
  void ask() { ++asked_; }
  std::uint64_t asked() const { return asked_; }
  bool pending() const { return answered_ != asked_; }
  // Of who has the turn: true once for all that were asked for.
  bool answer() {
    const std::uint64_t asked = asked_;
    return answered_.exchange(asked) != asked;
  }

 private:
  std::atomic<std::uint64_t> asked_{0}, answered_{0};
};

// What the library has to say, until it is asked for.
class Notices {
 public:
  void add(const std::string& text);
  std::optional<std::string> take();

 private:
  static constexpr std::size_t kMost = 100;
  std::mutex mutex_;
  std::deque<std::string> texts_;
};

class Worker {
 public:
  Worker() = default;
  Worker(const Worker&) = delete;
  Worker& operator=(const Worker&) = delete;
  ~Worker();

  // Errors: unavailable (the system gives no thread).
  Status add(rcbd_op& op);
  // Whether it is done; waits so long, for ever if < 0.
  bool wait(const rcbd_op& op, double seconds);

 private:
  void run();

  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<rcbd_op*> begun_;
  bool ending_ = false;
  std::thread thread_;
};

}  // namespace rcb::c

struct rcbd_client final : rcb::c::Handle {
  static constexpr auto kKind = rcb::c::Kind::client;
  rcbd_client() : Handle(kKind) {}
  ~rcbd_client() override = default;

  rcb::Status connect(rcb::client::ConnectOptions options);
  rcb::Status close() override;
  // Does the work when it is this call's turn. Errors also: busy, interrupted, invalid_argument (it is closed).
  // op: what ends waiting for the turn in place of rcbd_interrupt().
  template <typename Work>
  rcb::Status in_turn(const rcb::c::Left& left, const Work& work, const std::atomic<bool>* op = nullptr) {
    const auto stop = [this, op, before = interrupts.asked()] {
      return op != nullptr ? op->load() : interrupts.asked() != before;
    };
    if (rcb::Status status = turns.take(left.seconds(), stop); !status) return status;
    const Turn turn(*this);
    if (!client) return {rcb::Code::invalid_argument, "the client was closed"};
    return work();
  }
  // Gives the turn back. An interrupt that came meanwhile was for this call, also if it has ended by itself.
  struct Turn {
    explicit Turn(rcbd_client& of) : client(of) {}
    Turn(const Turn&) = delete;
    Turn& operator=(const Turn&) = delete;
    ~Turn() {
      if (!earlier) client.interrupts.answer();
      client.turns.give();
    }
    rcbd_client& client;
    const bool earlier = client.interrupts.pending();  // one that came between calls
  };

  rcb::c::Turns turns;
  rcb::c::Interrupts interrupts;
  rcb::c::Notices notices;
  // Of who has the turn:
  const std::atomic<bool>* cancelled = nullptr;  // of the op that is run
  std::optional<rcb::client::Client> client;     // none: closed
  std::set<rcbd_scene*> scenes;                  // those that are not closed
  rcb::c::Worker worker;                         // last: it ends first
};
