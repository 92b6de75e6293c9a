// ProcessId: identifies a process for as long as the machine runs. A pid alone may have been reused by another process;
// the pid with its start time is unique.
#pragma once

#include <cstdint>
#include <string>

#include <sys/types.h>

namespace rcb {

struct ProcessId {
  pid_t pid = -1;
  std::uint64_t start = 0;  // in clock ticks since boot, as in /proc/PID/stat

  static ProcessId self();
  // start is 0 if there is no such process.
  static ProcessId of(pid_t pid);
  // True while the process exists, even as a zombie.
  bool exists() const { return start != 0 && of(pid) == *this; }
  friend bool operator==(const ProcessId&, const ProcessId&) = default;

  // text() gives "PID.START"; parse() gives pid -1 for any other text.
  std::string text() const;
  static ProcessId parse(const std::string& text);
};

// Where this process's pid and start time are valid: on this machine since its boot, in this PID namespace. Empty if it
// can't be told.
std::string process_space();

}  // namespace rcb
