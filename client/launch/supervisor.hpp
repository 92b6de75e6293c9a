// Supervisor: runs the service's job and restarts it whenever it dies, until told to stop.
//
// Invariants
// 1. It holds the locks of the endpoint (endpoint_lock.hpp) and of the data directory from start to end, also between
//    two jobs. The note in the lock says what it is doing.
// 2. A job is restarted unless it ended cleanly (exit code 0), or had been told to end: then it leaves a marker in the
//    data directory, if that is there and has room. Pauses grow up to a limit; it never gives up.
// 3. A job that fails before it has ever answered isn't restarted: the reason is reported at once.
// 4. A job that runs but doesn't answer for silence_seconds is killed and counts as dead.
// 5. Nothing it reads or writes can block it or the job: the job's output comes through a pipe.
// 6. A fault of this process's own, such as a lack of memory, ends neither the job nor the supervisor: the log says so,
//    and it goes on. What can't be found out about the service, since its name can't be looked up or its data directory
//    can't be searched, isn't held against it.
// 7. When supervise() returns, no process of the job is left, nor its sockets; those of other services stay.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "client/launch/job/programs.hpp"
#include "common/base/status.hpp"

namespace rcb::launch {

struct SuperviseOptions {
  std::string endpoint;  // unix:PATH or HOST:PORT
  std::string data_dir;  // created if missing; one supervisor at a time
  int ranks = 1;
  Hosts hosts;  // the first of them is this machine
  // Further options of rcbd, used at every start. rcbd runs in /, so paths must be absolute.
  std::vector<std::string> service_arguments;
  std::string publish;    // absolute path of the file that tells clients where the service is; empty: none
  bool embedded = false;  // never restarted, and killed at the end, since it keeps nothing
  double ready_seconds = 60;
  double silence_seconds = 30;
  double ask_seconds = 10;           // interval between the probes of the service
  double pause_first_seconds = 0.5;  // after a first failure
  double pause_most_seconds = 30;
  double backoff_reset_seconds = 60;  // after a job has run so long, pauses start small again
  // When the service first answers, one byte kReady is written here; if the start fails, kFailed and then code, message
  // and hint of the reason, each ended by a zero byte. -1: none.
  int notify_fd = -1;
  // End of file: the starter has died or closed it, so all is stopped. A byte: the service outlives it. -1: none.
  int lifeline_fd = -1;
};

inline constexpr char kReady = 'R';
inline constexpr char kFailed = 'F';

// Name of the supervisor's process.
inline constexpr std::string_view kSupervisorName = "rcbd-supervisor";

std::string log_path(const std::string& data_dir);

// Returns when the service has ended for good: ok after a clean end or a stop by SIGTERM, SIGINT, SIGHUP (unless it is
// ignored, as under nohup) or the lifeline.
// Errors: why the service could not be started or kept.
Status supervise(const SuperviseOptions& options);

}  // namespace rcb::launch
