// Waits for a process that this one has started.
#pragma once

#include <optional>

#include <sys/types.h>

namespace rcb {

// How the child ended, as waitpid tells it; 0 if somebody else has reaped it. Nothing if it hasn't ended after so many
// seconds: then it is killed.
std::optional<int> wait_or_kill(pid_t child, double seconds);

}  // namespace rcb
