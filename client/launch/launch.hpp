// The launcher: starts a service and waits until it answers, either detached or embedded in this program.
//
// Both run under a supervisor in a process and session of its own (supervisor.hpp).
// Thread-safety: to be called while the program has one thread.
#pragma once

#include <functional>
#include <string>

#include <sys/types.h>

#include "client/launch/supervisor.hpp"
#include "common/base/status.hpp"
#include "common/files/descriptor.hpp"

namespace rcb::launch {

// Called from time to time while waiting, with the seconds waited so far.
using Progress = std::function<void(double seconds)>;

// Starts a service that outlives this program. On success the service answers; after an error, or if this program is
// interrupted during the call, nothing of it is left. Errors: the service's own reason; deadline_exceeded.
Status start_detached(SuperviseOptions options, const Progress& progress);

// A supervisor, and the pipes to it. When the first is closed, it ends its service; its own end closes the other.
struct Supervised {
  pid_t process = -1;
  Descriptor lifeline;
  Descriptor notify;
};

// A service that ends with this object or with this program, however that ends, and leaves nothing behind.
class Embedded {
 public:
  // Starts it in a folder of its own under TMPDIR (or /tmp, if TMPDIR is too long for a socket's path or not safe).
  static Result<Embedded> start(int ranks, const Progress& progress);
  Embedded(Embedded&&) = default;
  Embedded& operator=(Embedded&&) = delete;
  ~Embedded();

  const std::string& endpoint() const { return endpoint_; }
  // Adds the end of the service's log to the error of a call that lost the service.
  Status explain(Status status) const;

 private:
  Embedded() = default;

  std::string directory_;
  std::string endpoint_;
  Supervised supervised_;
};

struct Stopped {
  std::string endpoint;
  std::string said;  // what was ended or removed, in words
};
// Stops the service at the endpoint (empty: as the client library finds it) and waits until its processes and its
// socket are gone: first by a clean shutdown, after `deadline_seconds` by force, as far as its processes are known.
// Also ends a supervisor that waits to restart its service, and removes what a killed service has left. Errors:
// unavailable (there is nothing to end or remove), deadline_exceeded.
Result<Stopped> stop_service(const std::string& given, double deadline_seconds);

// Adds to the error of a call that found no service whether a supervisor is in charge there, and what that is about to
// do.
Status explain_absence(const std::string& given, Status status);

}  // namespace rcb::launch
