// Room `job`: mpirun and its processes, their folder, and where the programs are.
//
// Job: runs mpirun, once or several times in succession, each time with a new folder.
//
// Invariants
// 1. mpirun dies with the process that started it, and the ranks die with their mpirun.
// 2. After kill() no process of the job is left, nor its folder. Other children of this process are left alone: where
//    it was started by a shell's exec they are the user's, and where it is a container's first process it adopts them.
// 3. mpirun is never sent SIGTERM: it would take two seconds and end with an exit code that says nothing about the
//    ranks.
#pragma once

#include <optional>
#include <string>

#include <sys/types.h>

#include "client/launch/job/job_folder.hpp"
#include "client/launch/job/programs.hpp"
#include "common/base/status.hpp"

namespace rcb::launch {

// How mpirun ended.
struct JobEnd {
  bool clean = false;  // exit code 0: every rank ended as it was told to
  std::string text;    // "exit code 1", "signal 9"
};

class Job {
 public:
  // fallback: where the job's folder is created if not in /dev/shm. output_fd: becomes the job's standard output and
  // error. The calling process must be a child subreaper; whichever of its children end are waited for here.
  Job(JobSpec spec, std::string fallback, int output_fd);
  ~Job();
  Job(const Job&) = delete;
  Job& operator=(const Job&) = delete;

  Status start(bool restarted);
  bool running() const { return pid_ > 0; }
  // The service has written that it is up; whether it answers is for the caller to find out.
  bool ready() const;
  // At which TCP address the service has said that it listens, as numbers: so that nobody has to look up a name in
  // order to ask it. Empty if it hasn't said so yet.
  std::string address();
  // How mpirun ended, if it has; doesn't wait. Remains so until the next start() or kill().
  std::optional<JobEnd> poll();
  void kill();

 private:
  JobSpec spec_;
  std::string fallback_;
  int output_fd_;
  std::optional<JobFolder> folder_;
  std::string address_;
  pid_t pid_ = -1;
  pid_t session_ = -1;              // of mpirun and its ranks, and of nobody else
  std::optional<int> wait_status_;  // once mpirun has ended
};

}  // namespace rcb::launch
