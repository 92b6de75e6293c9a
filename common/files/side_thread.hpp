// SideThread: a thread beside those that must not wait, for what may take long or hang: files above all. Where a disk
// stands still (a network home whose server is away), it holds up those who asked for its files, and nobody else.
//
// Invariants
// 1. Jobs run one after another, in the order of post().
// 2. What waits is bounded: kJobsMax jobs, of `bytes_max` bytes together.
// 3. Nobody waits for a job; the destructor does for kEndSeconds at most. A job that hangs keeps the thread, which is
//    then left to itself, so jobs own whatever they touch.
// 4. The thread is started by the constructor. Where the system gives none, each post() tries again.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <thread>

#include "common/base/status.hpp"

namespace rcb {

class SideThread {
 public:
  using Job = std::function<void()>;
  using Start = std::function<std::thread(Job)>;  // throws std::system_error where there can be no thread
  static constexpr std::size_t kJobsMax = 1024;
  static constexpr double kEndSeconds = 2;

  explicit SideThread(std::uint64_t bytes_max, Start start = {});
  SideThread(const SideThread&) = delete;
  SideThread& operator=(const SideThread&) = delete;
  // Runs what waits, as far as kEndSeconds allow.
  ~SideThread();

  // Any thread. work: an exception ends it. then: called on the same thread when `work` has ended,
  // unless this object has gone by then; it must be quick, and may not use this object. bytes: the memory that the job
  // holds. Errors: busy (too much waits), unavailable (there is no thread).
  Status post(Job work, Job then = {}, std::uint64_t bytes = 0);
  // For what frees something, as the removal of a file: however much waits.
  void post_surely(Job work);

 private:
  struct State;
  Status add(Job work, Job then, std::uint64_t bytes, bool surely);

  std::shared_ptr<State> state_;
  std::thread thread_;
};

}  // namespace rcb
