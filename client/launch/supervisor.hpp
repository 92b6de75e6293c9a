// Supervisor: runs the service's job and starts it again when it dies.
//
// Invariants
// 1. A job is started again unless it left the clean-shutdown marker; the marker is removed before each start.
// 2. A job that fails before it has ever answered is not started again: the reason is told at once.
// 3. When supervise() returns, no process of the job is left, nor its socket.
// 4. While the service runs, the supervisor sleeps.
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
  // One byte kReady is written here when the service answers first, or kFailed and the reason's code, message and
  // hint, each ended by a zero byte. -1: none.
  int notify_fd = -1;
  // Its end of file means that the starter died: everything is stopped. A byte read from it ends that bond. -1: none.
  int lifeline_fd = -1;
};

inline constexpr char kReady = 'R';
inline constexpr char kFailed = 'F';

// In the data directory; locked by the supervisor, and holds the endpoint and its pid.
inline constexpr std::string_view kLaunchLockFile = "launch.lock";

// The name of the supervisor's process.
inline constexpr std::string_view kSupervisorName = "rcbd-supervisor";

std::string log_path(const std::string& data_dir);

// Returns when the service has ended for good: ok after a clean end or a stop by SIGTERM, SIGINT or the lifeline.
// Errors: the reason that the service could not be started or kept.
Status supervise(const SuperviseOptions& options);

}  // namespace rcb::launch
