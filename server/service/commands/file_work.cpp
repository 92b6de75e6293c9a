#include "server/service/commands/file_work.hpp"

#include <chrono>
#include <condition_variable>
#include <mutex>
#include <new>
#include <utility>

#include <fmt/format.h>

#include "server/service/context/collective.hpp"

namespace rcb::service {

struct FileWork::State {
  Status status() const {
    const std::lock_guard lock(mutex);
    return failed;
  }
  void begin() {
    const std::lock_guard lock(mutex);
    ++unfinished;
  }
  void end(const Status& status) {
    const std::lock_guard lock(mutex);
    if (failed.ok()) failed = status;
    --unfinished;
    ended.notify_all();
  }

  mutable std::mutex mutex;
  std::condition_variable ended;
  int unfinished = 0;
  Status failed;
  std::atomic<bool> stop = false;
};

FileWork::FileWork(SideThread& thread) : thread_(thread), state_(std::make_shared<State>()) {}

FileWork::~FileWork() { state_->stop = true; }

void FileWork::run(std::function<Status()> job) {
  state_->begin();
  const Status posted = thread_.post([state = state_, job = std::move(job)]() mutable {
    Status status;
    try {
      if (!state->stop && state->status().ok()) status = job();
    } catch (const std::bad_alloc&) {
      status = Status(Code::too_large, "a rank has no memory for the file",
                      "give the file to more ranks or a larger machine");
    } catch (const std::exception& fault) {
      status = Status(Code::internal, fmt::format("an internal fault in the work on a file: {}", fault.what()));
    }
    job = {};  // what it owns goes before its end is known
    state->end(status);
  });
  if (!posted.ok()) state_->end(posted);
}

int FileWork::unfinished() const {
  const std::lock_guard lock(state_->mutex);
  return state_->unfinished;
}

void FileWork::wait(int unfinished) const {
  constexpr std::chrono::milliseconds kMoment(20);
  std::unique_lock lock(state_->mutex);
  state_->ended.wait_for(lock, kMoment, [&] { return state_->unfinished <= unfinished; });
}

Status FileWork::status() const { return state_->status(); }

const std::atomic<bool>& FileWork::stop() const { return state_->stop; }

Status finish(Context& context, FileWork& work, const std::function<bool()>& more) {
  bool left = true;
  while (true) {
    while (left && work.status().ok() && work.unfinished() <= 1) left = more();
    left = left && work.status().ok();
    work.wait(left ? 1 : 0);
    std::uint64_t done = !left && work.unfinished() == 0 ? 1 : 0;
    context.comm.all_min({&done, 1});
    if (done != 0) return agree_status(context.comm, work.status());
    if (Status time = context.check_time(); !time.ok()) return time;
  }
}

}  // namespace rcb::service
