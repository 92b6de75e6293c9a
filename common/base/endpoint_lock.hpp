// Who serves an endpoint: one lock an endpoint, whatever data directories its services have, held by the supervisor of
// `rcbctl up` for as long as it looks after the service, also while that is dead and about to be started again, or by
// rank 0 of an rcbd that runs without one. The note in it says who that is, and how the service is.
#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "common/base/lock_file.hpp"
#include "common/base/process_id.hpp"
#include "common/base/status.hpp"

namespace rcb {

struct EndpointNote {
  ProcessId process;
  std::string program;  // "rcbctl up" or "rcbd"
  std::string endpoint;
  std::string data_dir;
  int deaths = 0;            // of the service since its supervisor was started
  int failures = 0;          // of those, the last in a row
  double start_at_unix = 0;  // where it waits: when it starts the service again; else 0
  std::string last_reason;   // of the last death

  std::string text() const;
  // Fields that are missing or wrong keep their defaults.
  static EndpointNote parse(const std::string& text);
};

// Names the supervisor of a job in the environment of its ranks (ProcessId::text()).
inline constexpr const char* kSupervisorVariable = "RCBD_SUPERVISOR";

// SOCKET.lock beside a Unix socket, for HOST:PORT the file endpoint.lock in its default data directory.
std::string endpoint_lock_path(std::string_view endpoint);
// Of note.endpoint. Errors: those of LockFile::take; busy names who serves the endpoint.
Result<LockFile> take_endpoint(const EndpointNote& note);
// Of note.data_dir, which is there: one service at a time. Errors: likewise.
Result<LockFile> take_data_directory(const EndpointNote& note);
// This process is a rank, and its supervisor, as the environment names it, has that lock for both.
bool held_by_supervisor(const std::string& lock_path);
// The live process that serves the endpoint, or is about to.
std::optional<EndpointNote> endpoint_holder(std::string_view endpoint);

// "pid 7 (rcbctl up), data directory D", and where it waits: "which starts it again in 4 s (dead 3 times; last
// reason)".
std::string describe(const EndpointNote& note);

}  // namespace rcb
