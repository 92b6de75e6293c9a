#include "common/base/child.hpp"

#include <csignal>

#include <sys/wait.h>
#include <unistd.h>

#include "common/base/clock.hpp"

namespace rcb {

void keep_ended_children() { ::signal(SIGCHLD, SIG_DFL); }

std::optional<int> wait_or_kill(pid_t child, double seconds) {
  constexpr useconds_t kMicroseconds = 1000;
  const SteadyClock clock;
  const double deadline = clock.seconds() + seconds;
  int status = 0;
  while (::waitpid(child, &status, WNOHANG) == 0) {
    if (clock.seconds() > deadline) {
      ::kill(child, SIGKILL);
      ::waitpid(child, &status, 0);
      return std::nullopt;
    }
    ::usleep(kMicroseconds);
  }
  return status;
}

}  // namespace rcb
