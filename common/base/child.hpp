// Waiting for processes that this one has started.
#pragma once

#include <optional>

#include <sys/types.h>

namespace rcb {

// Resets SIGCHLD to its default. A process that is started with SIGCHLD ignored, as by some daemons or after "trap ''
// CHLD" in a shell, inherits that, and the kernel would then not keep how its children ended.
void keep_ended_children();

// How the child ended, as waitpid tells it; 0 if somebody else has reaped it. Nothing if it hasn't ended after so many
// seconds: then it is killed.
std::optional<int> wait_or_kill(pid_t child, double seconds);

}  // namespace rcb
