// The one launcher: starts a service and waits until it answers, as a service of its own or embedded in this program.
//
// Both run under a supervisor in a process and session of their own (supervisor.hpp).
// Thread-safety: to be called while the program has one thread.
#pragma once

#include <functional>
#include <string>

#include <sys/types.h>

#include "client/launch/supervisor.hpp"
#include "common/base/status.hpp"

namespace rcb::launch {

// Called every now and then while waiting, with the seconds waited.
using Progress = std::function<void(double seconds)>;

// Starts a service that outlives this program. When this returns ok the service answers; when it fails, or this
// program is interrupted meanwhile, nothing is left of it. Errors: the service's own reason; deadline_exceeded.
Status start_detached(SuperviseOptions options, const Progress& progress);

// A service that ends with this object, or with this program however that ends, and leaves nothing.
class Embedded {
 public:
  // In a folder of its own under TMPDIR (or /tmp, where that is too long a path for a socket).
  static Result<Embedded> start(int ranks, const Progress& progress);
  Embedded(Embedded&& other) noexcept;
  Embedded& operator=(Embedded&&) = delete;
  ~Embedded();

  const std::string& endpoint() const { return endpoint_; }
  // Adds what the service's log says to the failure of a call that lost its service.
  Status explain(Status status) const;

 private:
  Embedded() = default;

  std::string directory_;
  std::string endpoint_;
  int lifeline_fd_ = -1;
  int notify_fd_ = -1;
  pid_t supervisor_ = -1;
};

struct Stopped {
  std::string endpoint;
  std::string said;  // what was ended or removed, in words
};
// Stops the service at the endpoint (empty: as the client library finds it) and waits until its processes and its
// socket are gone. Clean; after `deadline_seconds` by force where its supervisor is known. Also ends a supervisor that
// waits to start its service again, and removes what a service that was killed has left. Errors: unavailable (nothing
// of all this), deadline_exceeded.
Result<Stopped> stop_service(const std::string& given, double deadline_seconds);

// To the failure of a call that found no service: whether a supervisor looks after one there, and what it is about to
// do.
Status explain_absence(const std::string& given, Status status);

}  // namespace rcb::launch
