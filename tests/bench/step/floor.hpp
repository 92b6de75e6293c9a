// Floors: the least that bringing bytes into the memory of other processes can cost, or reading them where they are,
// and nothing else.
#pragma once

#include <cstddef>
#include <optional>
#include <vector>

#include <sys/types.h>

namespace rcb::bench {

// A forked process and this end of the socket between the two; both go with this object.
class FloorProcess {
 public:
  FloorProcess() = default;
  FloorProcess(int socket, pid_t process) : socket_(socket), process_(process) {}
  FloorProcess(FloorProcess&& other) noexcept;
  FloorProcess& operator=(FloorProcess&&) = delete;
  ~FloorProcess();
  int socket() const { return socket_; }

 private:
  int socket_ = -1;
  pid_t process_ = -1;
};

// Through bare Unix sockets; or copied by the processes from memory that they share with this one; or, as a pass over
// its particles does, read once by each process in memory of its own.
class Floor {
 public:
  enum class Kind { sockets, memory, read };
  // One process for each entry, which takes that many bytes each time. To be made while this program has one thread.
  Floor(Kind kind, std::vector<std::size_t> bytes);
  ~Floor();
  Floor(const Floor&) = delete;
  Floor& operator=(const Floor&) = delete;

  // Seconds until all processes have their bytes from `from` (as many as all together), or have read them. What a
  // solver does itself, putting them into the memory where they are read, isn't timed. None: a process is gone.
  std::optional<double> seconds(const std::byte* from);

 private:
  struct Receiver {
    FloorProcess process;
    std::size_t bytes = 0;
  };
  bool send(const std::byte* from);
  bool all_answer(char word);
  std::optional<double> read();

  Kind kind_;
  std::byte* shared_ = nullptr;
  std::size_t shared_bytes_ = 0;
  std::vector<Receiver> receivers_;
};

// A message through a bare Unix socket to another process, and its answer.
class RoundTrip {
 public:
  static constexpr std::size_t kBytesMin = 16, kBytesMax = std::size_t{1} << 20U;  // of a message, and of an answer
  RoundTrip();                                                                     // while this program has one thread
  // Sizes outside the limits are taken as the nearest one. None: the process is gone.
  std::optional<double> seconds(std::size_t message, std::size_t answer);

 private:
  FloorProcess process_;
  std::vector<std::byte> buffer_;
};

}  // namespace rcb::bench
