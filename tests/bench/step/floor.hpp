// Floors: the least that bringing bytes into the memory of other processes can cost, and nothing else.
#pragma once

#include <cstddef>
#include <vector>

#include <sys/types.h>

namespace rcb::bench {

// Through bare Unix sockets, or copied by the processes from memory that they share with this one.
class Floor {
 public:
  enum class Kind { sockets, memory };
  // One process for each entry, which takes that many bytes each time. To be made while this program has one thread.
  Floor(Kind kind, std::vector<std::size_t> bytes);
  ~Floor();
  Floor(const Floor&) = delete;
  Floor& operator=(const Floor&) = delete;

  // Kind::memory: puts what the next send() brings into the shared memory, as a solver that computes there.
  void load(const std::byte* from);
  // Sends everyone its bytes from `from` (as many as all together), or has them copy theirs, and waits until all have
  // them. False: a process is gone.
  bool send(const std::byte* from);

 private:
  struct Receiver {
    int socket = -1;
    pid_t process = -1;
    std::size_t bytes = 0;
  };
  bool copied();

  Kind kind_;
  std::byte* shared_ = nullptr;
  std::size_t shared_bytes_ = 0;
  std::vector<Receiver> receivers_;
};

}  // namespace rcb::bench
