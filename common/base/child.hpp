// Waiting for processes that this one has started.
#pragma once

#include <optional>

#include <sys/types.h>

namespace rcb {

// From now on the kernel keeps how a child has ended until somebody waits for it. Where whoever started this process
// ignores SIGCHLD, as some daemons do and "trap '' CHLD" in a shell, it would not: that is inherited.
void keep_ended_children();

// How the child ended, as waitpid tells it; 0 if somebody else has reaped it. Nothing if it hasn't ended after so many
// seconds: then it is killed.
std::optional<int> wait_or_kill(pid_t child, double seconds);

}  // namespace rcb
