// ProcessId: a process for as long as the machine runs. Its number alone may be another's by now; with the time at
// which it started it is not.
#pragma once

#include <cstdint>
#include <string>

#include <sys/types.h>

namespace rcb {

struct ProcessId {
  pid_t pid = -1;
  std::uint64_t start = 0;  // in clock ticks since the machine's start, as /proc/PID/stat has it

  static ProcessId self();
  // start is 0 where there is no such process.
  static ProcessId of(pid_t pid);
  // It is there, if only as one that has ended and nobody has asked how.
  bool exists() const { return start != 0 && of(pid) == *this; }
  friend bool operator==(const ProcessId&, const ProcessId&) = default;

  // "PID.START"; pid -1 where a text is none.
  std::string text() const;
  static ProcessId parse(const std::string& text);
};

}  // namespace rcb
