// Supervisor: runs the service's job and starts it again when it dies, as long as it is let.
//
// Invariants
// 1. It has the endpoint's lock (endpoint_lock.hpp) from start to end, between two jobs too, and the data directory's.
//    The note in the lock says what it does.
// 2. A job is started again unless it ended cleanly: exit code 0, or the clean-shutdown marker, which a full disk or a
//    removed data directory may keep from being written. The pauses grow up to a cap; it never gives up.
// 3. A job that fails before it has ever answered is not started again: the reason is told at once.
// 4. A job that runs but doesn't answer for silence_seconds is killed, and counts as dead.
// 5. Nothing that it writes or reads can keep it, or the job, waiting: the job's output comes through a pipe.
// 6. When supervise() returns, no process of the job is left, nor its sockets; another's stay.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.hpp"

namespace rcb::launch {

struct SuperviseOptions {
  std::string endpoint;  // unix:PATH or HOST:PORT
  std::string data_dir;  // made if missing; one supervisor at a time
  int ranks = 1;
  // More of rcbd's options, at every start. rcbd runs in /, so paths must be absolute.
  std::vector<std::string> service_arguments;
  bool embedded = false;  // nothing in it lasts: no restart, and its end is a kill
  double ready_seconds = 60;
  double silence_seconds = 30;
  double ask_seconds = 10;           // how often it is asked whether it answers
  double pause_first_seconds = 0.5;  // after a first failure
  double pause_most_seconds = 30;
  double steady_seconds = 60;  // a job that lives so long ends a row of failures
  // One byte kReady is written here when the service answers first, or kFailed and the reason's code, message and
  // hint, each ended by a zero byte. -1: none.
  int notify_fd = -1;
  // Its end of file means that the starter died: everything is stopped. A byte read from it ends that bond. -1: none.
  int lifeline_fd = -1;
};

inline constexpr char kReady = 'R';
inline constexpr char kFailed = 'F';

// The name of the supervisor's process.
inline constexpr std::string_view kSupervisorName = "rcbd-supervisor";

std::string log_path(const std::string& data_dir);

// Returns when the service has ended for good: ok after a clean end or a stop by SIGTERM, SIGINT or the lifeline.
// Errors: the reason that the service could not be started or kept.
Status supervise(const SuperviseOptions& options);

}  // namespace rcb::launch
