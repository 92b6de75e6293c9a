// Who serves an endpoint. There is one lock for each endpoint, whatever data directories its services use. The
// supervisor of `rcbctl up` holds it for as long as it looks after the service, even while the service is dead and
// waits to be restarted; without a supervisor rank 0 of rcbd holds it. The note in the lock file says who holds the
// lock and how the service is.
#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "common/base/status.hpp"
#include "common/files/lock_file.hpp"
#include "common/files/process_id.hpp"

namespace rcb {

struct EndpointNote {
  ProcessId process;
  std::string program;  // "rcbctl up" or "rcbd"
  std::string endpoint;
  std::string data_dir;
  int deaths = 0;            // deaths of the service since its supervisor was started
  int failures = 0;          // deaths since the service last stayed up for a while
  double start_at_unix = 0;  // when the supervisor restarts the service, if it waits to; else 0
  std::string last_reason;   // why the service died last

  std::string text() const;
  // Missing and malformed fields keep their defaults.
  static EndpointNote parse(const std::string& text);
};

// Environment variable that tells the ranks who supervises their job (ProcessId::text()).
inline constexpr const char* kSupervisorVariable = "RCBD_SUPERVISOR";

// For a Unix socket SOCKET.lock beside it, for HOST:PORT the file endpoint.lock in the endpoint's default data
// directory.
std::string endpoint_lock_path(std::string_view endpoint);
// Locks note.endpoint. Errors: those of LockFile::take; the message of busy names the holder.
Result<LockFile> take_endpoint(const EndpointNote& note);
// Locks note.data_dir, which must exist: one service at a time may use it. Errors: likewise.
Result<LockFile> take_data_directory(const EndpointNote& note);
// True if this process is a rank and its supervisor, named in the environment, holds the lock at `lock_path` for both.
bool held_by_supervisor(const std::string& lock_path);
// The note of the live process that serves the endpoint or is about to; nothing if there is none.
std::optional<EndpointNote> endpoint_holder(std::string_view endpoint);

// "pid 7 (rcbctl up), data directory D", followed, if the service waits for its restart, by ", which starts it again in
// 4 s (it has died 3 times, at last: reason)".
std::string describe(const EndpointNote& note);

}  // namespace rcb
