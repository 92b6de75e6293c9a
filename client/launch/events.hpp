// Events: what a supervisor waits for: that a child ends, a signal to stop, the job's output, and the end of whoever
// started it.
//
// Invariants
// 1. From open() to the end of this object SIGCHLD, SIGTERM and SIGINT are blocked in this process and come as events;
//    SIGHUP too, unless it is ignored.
#pragma once

#include <functional>
#include <string>
#include <string_view>

#include <signal.h>

#include "common/base/status.hpp"
#include "common/files/descriptor.hpp"

namespace rcb::launch {

class Events {
 public:
  enum class Event { none, child, stop };
  using OnOutput = std::function<void(std::string_view bytes)>;

  Events() = default;
  ~Events();

  // lifeline_fd: SuperviseOptions::lifeline_fd.
  Status open(int lifeline_fd);
  // Where the job writes its output.
  int output_fd() const { return to_write_.get(); }
  // Sleeps until a child has ended, a stop was asked for, or `seconds` have passed (negative: no limit). Reads the
  // job's output meanwhile.
  Event wait(double seconds, const OnOutput& on_output);
  // Reads what the job has written.
  void drain(const OnOutput& on_output);

 private:
  Event read_signals() const;

  Descriptor to_read_, to_write_;  // the pipe for the job's output
  Descriptor signals_;
  int lifeline_fd_ = -1;
  sigset_t signals_before_{};
  std::string buffer_;  // for output; made once, so that a lack of memory later doesn't stop the reading
};

}  // namespace rcb::launch
