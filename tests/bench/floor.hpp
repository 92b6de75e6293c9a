// The floor: bytes through bare Unix sockets into the memory of other processes, and nothing else.
#pragma once

#include <cstddef>
#include <vector>

#include <sys/types.h>

namespace rcb::bench {

class Floor {
 public:
  // One process for each entry, which takes that many bytes each time. To be made while this program has one thread.
  explicit Floor(std::vector<std::size_t> bytes);
  ~Floor();
  Floor(const Floor&) = delete;
  Floor& operator=(const Floor&) = delete;

  // Sends everyone its bytes from `from` (as many as all together) and waits until all have them. False: a process is
  // gone.
  bool send(const std::byte* from);

 private:
  struct Receiver {
    int socket = -1;
    pid_t process = -1;
    std::size_t bytes = 0;
  };
  std::vector<Receiver> receivers_;
};

}  // namespace rcb::bench
