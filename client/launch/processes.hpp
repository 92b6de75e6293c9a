// Processes of this machine: who they are, and handles that no later process of the same number can be mistaken
// for.
#pragma once

#include <string>

#include <sys/types.h>

#include "client/lib/client.hpp"
#include "common/base/process_id.hpp"

namespace rcb::launch {

struct ProcessInfo {
  std::string name;
  pid_t parent = 0;
};
// Empty where there is no such process.
ProcessInfo process_info(pid_t pid);

// The number of rank 0's process as the service tells it; -1 if it doesn't.
pid_t rank0_of(client::Client& client, double deadline_seconds);

class Process {
 public:
  explicit Process(const ProcessId& id);
  Process(Process&& other) noexcept;
  Process& operator=(Process&&) = delete;
  ~Process();

  pid_t pid() const { return id_.pid; }
  // Waits so long at most.
  bool ended(double seconds) const;
  void signal(int number) const;

 private:
  ProcessId id_;
  int handle_ = -1;
};

}  // namespace rcb::launch
