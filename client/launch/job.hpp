// Job: one run of mpirun, and the folders it may fill.
//
// Invariants
// 1. mpirun dies with the process that started it, and the ranks with their mpirun.
// 2. After kill() no process of the job is left, and nothing of Open MPI's in its folders.
// 3. mpirun is never sent SIGTERM: it would take two seconds and end with an exit code that tells nothing.
#pragma once

#include <optional>
#include <string>

#include <sys/types.h>

#include "client/launch/programs.hpp"
#include "common/base/status.hpp"

namespace rcb::launch {

class Job {
 public:
  // tmp_dir: a folder of the job's own, made here and removed with the job; Open MPI's session files go there.
  // log_fd: the job's standard output and error. The calling process must be a child subreaper, and have no other
  // children.
  Job(JobSpec spec, std::string tmp_dir, int log_fd);
  ~Job();
  Job(const Job&) = delete;
  Job& operator=(const Job&) = delete;

  // Clears what an earlier job left in the folders, and starts mpirun.
  Status start(bool restarted);
  bool running() const { return pid_ > 0; }
  pid_t pid() const { return pid_; }
  // How mpirun ended, in words, once it has; without waiting.
  std::optional<std::string> poll();
  void kill();

 private:
  void clean() const;

  JobSpec spec_;
  std::string tmp_dir_;
  int log_fd_;
  pid_t pid_ = -1;
};

}  // namespace rcb::launch
