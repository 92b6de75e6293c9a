// Processes of this machine: their names and parents, and handles that can't be mistaken for a later process with the
// same number.
#pragma once

#include <string>

#include <sys/types.h>

#include "client/lib/client.hpp"
#include "common/files/descriptor.hpp"
#include "common/files/process_id.hpp"

namespace rcb::launch {

struct ProcessInfo {
  std::string name;
  pid_t parent = 0;
};
// Empty if there is no such process.
ProcessInfo process_info(pid_t pid);

// Rank 0, as told by the service; pid -1 if it doesn't tell, or runs where this process can't see it: on another
// machine or in another PID namespace, where the same number may be any other process.
ProcessId rank0_of(client::Client& client, double deadline_seconds);

class Process {
 public:
  explicit Process(const ProcessId& id);

  pid_t pid() const { return id_.pid; }
  // Whether the process has ended; waits at most `seconds` for that.
  bool ended(double seconds) const;
  void signal(int number) const;

 private:
  ProcessId id_;
  Descriptor handle_;
};

}  // namespace rcb::launch
