#include "common/files/side_thread.hpp"

#include <chrono>
#include <condition_variable>
#include <deque>
#include <exception>
#include <mutex>
#include <system_error>
#include <utility>

#include <fmt/format.h>

namespace rcb {

namespace {

// What nobody is there any more to take back is never destroyed: that could use what has gone with its owner.
void leave(SideThread::Job job) {
  static std::mutex mutex;
  static auto* const left = new std::deque<SideThread::Job>;
  const std::lock_guard lock(mutex);
  left->push_back(std::move(job));
}

}  // namespace

struct SideThread::State {
  struct Waiting {
    Job work;
    Job then;
    std::uint64_t bytes = 0;
  };

  void run() {
    std::unique_lock lock(mutex);
    while (true) {
      filled.wait(lock, [this] { return !jobs.empty() || ending; });  // no deadline: an idle thread sleeps
      if (jobs.empty() || orphaned) break;
      Waiting job = std::move(jobs.front());
      jobs.pop_front();
      lock.unlock();
      try {
        job.work();
      } catch (const std::exception&) {
        // No memory, or a bug: who waits for the job finds nothing done.
      }
      job.work = {};  // what it owns goes before anybody hears that it has ended
      lock.lock();
      bytes -= job.bytes;
      if (job.then && !orphaned) job.then();
      if (orphaned) leave(std::move(job.then));
    }
    ended = true;
    drained.notify_all();
  }

  std::uint64_t bytes_max = 0;
  Start start;
  std::mutex mutex;
  std::condition_variable filled;
  std::condition_variable drained;
  std::deque<Waiting> jobs;
  std::uint64_t bytes = 0;  // of the jobs, with the one that runs
  bool ending = false;
  bool orphaned = false;  // the owner has gone
  bool ended = false;
};

SideThread::SideThread(std::uint64_t bytes_max, Start start) : state_(std::make_shared<State>()) {
  state_->bytes_max = bytes_max;
  state_->start = start ? std::move(start) : [](Job run) { return std::thread(std::move(run)); };
  try {
    thread_ = state_->start([state = state_] { state->run(); });
  } catch (const std::system_error&) {
    // post() tries again, and says why it can't.
  }
}

SideThread::~SideThread() {
  std::unique_lock lock(state_->mutex);
  state_->ending = true;
  state_->filled.notify_all();
  if (!thread_.joinable()) return;
  const bool ended =
      state_->drained.wait_for(lock, std::chrono::duration<double>(kEndSeconds), [this] { return state_->ended; });
  state_->orphaned = true;
  // What waits for the end of a job hears here that it won't come. What the jobs own may be files, whose end could hang
  // as well: that is left to the thread.
  std::deque<Job> dropped;
  for (State::Waiting& job : state_->jobs) dropped.push_back(std::exchange(job.then, {}));
  lock.unlock();
  if (ended)
    thread_.join();
  else
    thread_.detach();
}

Status SideThread::add(Job work, Job then, std::uint64_t bytes, bool surely) {
  const std::lock_guard lock(state_->mutex);
  if (!thread_.joinable()) try {
      thread_ = state_->start([state = state_] { state->run(); });
    } catch (const std::system_error& fault) {
      return {Code::unavailable, fmt::format("the service can start no thread: {}", fault.code().message()),
              "raise the limit on processes of the service's user or container (ulimit -u, pids.max)"};
    }
  const bool fits =
      state_->jobs.size() < kJobsMax && (state_->bytes == 0 || state_->bytes + bytes <= state_->bytes_max);
  if (!fits && !surely)
    return {Code::busy, "the disk is slow, and much waits for it already", "try again when it answers"};
  state_->bytes += bytes;
  state_->jobs.push_back({std::move(work), std::move(then), bytes});
  state_->filled.notify_all();
  return {};
}

Status SideThread::post(Job work, Job then, std::uint64_t bytes) {
  return add(std::move(work), std::move(then), bytes, false);
}

void SideThread::post_surely(Job work) { static_cast<void>(add(std::move(work), {}, 0, true)); }

}  // namespace rcb
