// FileWork: what a command does on this rank's thread for files. A disk may stand still for ever: so the thread owns
// what it works with, and a command that is given up leaves the work to the thread.
#pragma once

#include <atomic>
#include <functional>
#include <memory>

#include "common/base/status.hpp"
#include "server/service/context/context.hpp"

namespace rcb::service {

class FileWork {
 public:
  explicit FileWork(SideThread& thread);
  FileWork(const FileWork&) = delete;
  FileWork& operator=(const FileWork&) = delete;
  // Jobs that aren't begun aren't run any more.
  ~FileWork();

  // Runs `job` on the thread, unless an earlier one has failed.
  void run(std::function<Status()> job);
  int unfinished() const;
  // Waits until no more than so many jobs are unfinished, but not longer than a moment.
  void wait(int unfinished) const;
  // Why a job has failed, or couldn't be run.
  Status status() const;
  // Set when the command is given up; lives as long as a job.
  const std::atomic<bool>& stop() const;

 private:
  struct State;
  SideThread& thread_;
  std::shared_ptr<State> state_;
};

// Waits for the work of all ranks, while they give way to orders of other scenes. more: called before each look while
// no more than one job is unfinished, to add another; false: that was the last. Collective. Errors: those of
// check_time() (what is unfinished is left to the thread then), else the same on all ranks.
Status finish(Context& context, FileWork& work, const std::function<bool()>& more);

}  // namespace rcb::service
