// Signal handlers that leave alone what whoever started this process ignores.
#pragma once

#include <csignal>

namespace rcb {

// Installs the handler unless the signal is being ignored, as nohup does with SIGHUP, and a shell with SIGINT for what
// a script runs beside it.
inline void handle_unless_ignored(int number, const struct sigaction& action) {
  struct sigaction before {};
  if (::sigaction(number, nullptr, &before) == 0 && before.sa_handler == SIG_IGN) return;
  ::sigaction(number, &action, nullptr);
}

}  // namespace rcb
