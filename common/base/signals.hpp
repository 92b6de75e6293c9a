// Signals: handlers that leave alone what whoever started this process ignores, and threads that take none.
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

// While this lives the calling thread takes no signals, and threads that it starts take none ever: in a library they are
// for the threads of the program.
class SignalsBlocked {
 public:
  SignalsBlocked() {
    sigset_t all;
    ::sigfillset(&all);
    ::pthread_sigmask(SIG_SETMASK, &all, &before_);
  }
  SignalsBlocked(const SignalsBlocked&) = delete;
  SignalsBlocked& operator=(const SignalsBlocked&) = delete;
  ~SignalsBlocked() { ::pthread_sigmask(SIG_SETMASK, &before_, nullptr); }

 private:
  sigset_t before_{};
};

}  // namespace rcb
