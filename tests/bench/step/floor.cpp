#include "tests/bench/step/floor.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstdint>
#include <cstring>
#include <utility>

#include <poll.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include "common/base/clock.hpp"
#include "tests/bench/measure.hpp"

namespace rcb::bench {
namespace {

constexpr int kBufferBytes = 1 << 20;
constexpr std::size_t kChunkBytes = std::size_t{1} << 20U;
constexpr int kPollMilliseconds = 10'000;
// What a process of Kind::read is told: to fetch its bytes, and to read them.
constexpr char kLoadWord = 'l';
constexpr char kReadWord = 'r';

bool receive_all(int socket, std::byte* to, std::size_t bytes) {
  for (std::size_t have = 0; have < bytes;) {
    const ssize_t got = ::recv(socket, to + have, std::min(bytes - have, kChunkBytes), 0);
    if (got <= 0) return false;
    have += static_cast<std::size_t>(got);
  }
  return true;
}

bool send_all(int socket, const void* from, std::size_t bytes) {
  for (std::size_t sent = 0; sent < bytes;) {
    const ssize_t put = ::send(socket, static_cast<const std::byte*>(from) + sent, bytes - sent, MSG_NOSIGNAL);
    if (put <= 0) return false;
    sent += static_cast<std::size_t>(put);
  }
  return true;
}

void receive(int socket, std::size_t bytes) {
  std::vector<std::byte> memory(bytes);
  const char done = 1;
  while (receive_all(socket, memory.data(), bytes) && send_all(socket, &done, 1)) {
  }
}

// Copies its bytes each time it is asked to.
void copy(int socket, const std::byte* from, std::size_t bytes) {
  std::vector<std::byte> memory(bytes);
  char word = 0;
  while (::recv(socket, &word, 1, 0) == 1) {
    std::memcpy(memory.data(), from, bytes);
    // What it copied is of use to somebody, as far as the compiler can tell.
    asm volatile("" : : "r"(memory.data()) : "memory");
    if (!send_all(socket, &word, 1)) return;
  }
}

// Answers a reading with its begin and its end, by the clock that all processes of a machine share.
void read_own(int socket, const std::byte* from, std::size_t bytes) {
  std::vector<double> memory(bytes / sizeof(double));
  const SteadyClock clock;
  char word = 0;
  while (::recv(socket, &word, 1, 0) == 1) {
    if (word == kLoadWord) std::memcpy(memory.data(), from, memory.size() * sizeof(double));
    std::array<double, 2> times{clock.seconds(), 0};
    if (word == kReadWord) {
      const std::uint64_t sum = read_doubles(memory);
      asm volatile("" : : "r"(sum));
    }
    times[1] = clock.seconds();
    if (!(word == kReadWord ? send_all(socket, times.data(), sizeof times) : send_all(socket, &word, 1))) return;
  }
}

// A message begins with its own size and that of the answer.
void answer(int socket) {
  std::vector<std::byte> memory(RoundTrip::kBytesMax);
  std::array<std::uint64_t, 2> sizes{};
  static_assert(sizeof sizes == RoundTrip::kBytesMin);
  while (true) {
    std::size_t have = 0;
    do {
      const ssize_t got = ::recv(socket, memory.data() + have, memory.size() - have, 0);
      if (got <= 0) return;
      have += static_cast<std::size_t>(got);
      if (have >= sizeof sizes) std::memcpy(sizes.data(), memory.data(), sizeof sizes);
    } while (have < sizeof sizes || have < sizes[0]);
    if (!send_all(socket, memory.data(), sizes[1])) return;
  }
}

// Forks a process that runs `work` with its end of a socket.
FloorProcess fork_process(const auto& work) {
  int pair[2] = {-1, -1};
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair) != 0) return {};
  ::setsockopt(pair[0], SOL_SOCKET, SO_SNDBUF, &kBufferBytes, sizeof kBufferBytes);
  const pid_t child = ::fork();
  if (child == 0) {
    // Else this process would keep the others' sockets open.
    ::close_range(STDERR_FILENO + 1, static_cast<unsigned>(pair[1]) - 1, 0);
    ::close_range(static_cast<unsigned>(pair[1]) + 1, ~0U, 0);
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    work(pair[1]);
    ::_exit(0);
  }
  ::close(pair[1]);
  return {pair[0], child};
}

}  // namespace

FloorProcess::FloorProcess(FloorProcess&& other) noexcept
    : socket_(std::exchange(other.socket_, -1)), process_(std::exchange(other.process_, -1)) {}

FloorProcess::~FloorProcess() {
  if (socket_ >= 0) ::close(socket_);
  if (process_ > 0) ::waitpid(process_, nullptr, 0);
}

Floor::Floor(Kind kind, std::vector<std::size_t> bytes) : kind_(kind) {
  for (const std::size_t each : bytes) shared_bytes_ += kind == Kind::sockets ? 0 : each;
  if (shared_bytes_ > 0) {
    void* const at = ::mmap(nullptr, shared_bytes_, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    shared_ = at == MAP_FAILED ? nullptr : static_cast<std::byte*>(at);
    if (shared_ == nullptr) return;
  }
  const std::byte* share = shared_;
  for (const std::size_t each : bytes) {
    receivers_.push_back({fork_process([&](int socket) {
                            if (kind == Kind::sockets) receive(socket, each);
                            if (kind == Kind::memory) copy(socket, share, each);
                            if (kind == Kind::read) read_own(socket, share, each);
                          }),
                          each});
    if (shared_ != nullptr) share += each;
  }
}

Floor::~Floor() {
  receivers_.clear();
  if (shared_ != nullptr) ::munmap(shared_, shared_bytes_);
}

std::optional<double> Floor::seconds(const std::byte* from) {
  if (shared_ != nullptr) std::memcpy(shared_, from, shared_bytes_);
  if (kind_ == Kind::read) return read();
  const SteadyClock clock;
  const double start = clock.seconds();
  if (!(kind_ == Kind::memory ? all_answer(kLoadWord) : send(from))) return std::nullopt;
  return clock.seconds() - start;
}

bool Floor::all_answer(char word) {
  for (const Receiver& receiver : receivers_)
    if (::send(receiver.process.socket(), &word, 1, MSG_NOSIGNAL) != 1) return false;
  for (const Receiver& receiver : receivers_)
    if (::recv(receiver.process.socket(), &word, 1, 0) != 1) return false;
  return !receivers_.empty();
}

std::optional<double> Floor::read() {
  if (!all_answer(kLoadWord)) return std::nullopt;
  for (const Receiver& receiver : receivers_)
    if (!send_all(receiver.process.socket(), &kReadWord, 1)) return std::nullopt;
  std::vector<double> begins, ends;
  for (const Receiver& receiver : receivers_) {
    std::array<double, 2> times{};
    if (!receive_all(receiver.process.socket(), reinterpret_cast<std::byte*>(times.data()), sizeof times))
      return std::nullopt;
    begins.push_back(times[0]);
    ends.push_back(times[1]);
  }
  return *std::max_element(ends.begin(), ends.end()) - *std::min_element(begins.begin(), begins.end());
}

bool Floor::send(const std::byte* from) {
  struct Rest {
    const std::byte* at;
    std::size_t bytes;
  };
  std::vector<Rest> rests;
  for (const Receiver& receiver : receivers_) {
    rests.push_back({from, receiver.bytes});
    from += receiver.bytes;
  }
  for (bool unfinished = true; unfinished;) {
    unfinished = false;
    bool moved = false;
    std::vector<pollfd> full;
    for (std::size_t r = 0; r < rests.size(); ++r) {
      if (rests[r].bytes == 0) continue;
      const int socket = receivers_[r].process.socket();
      const ssize_t sent =
          ::send(socket, rests[r].at, std::min(rests[r].bytes, kChunkBytes), MSG_DONTWAIT | MSG_NOSIGNAL);
      if (sent < 0 && errno != EAGAIN) return false;
      if (sent > 0) {
        rests[r].at += sent;
        rests[r].bytes -= static_cast<std::size_t>(sent);
        moved = true;
      }
      if (rests[r].bytes == 0) continue;
      unfinished = true;
      full.push_back({socket, POLLOUT, 0});
    }
    if (unfinished && !moved && ::poll(full.data(), full.size(), kPollMilliseconds) <= 0) return false;
  }
  for (const Receiver& receiver : receivers_) {
    char done = 0;
    if (receiver.bytes > 0 && ::recv(receiver.process.socket(), &done, 1, 0) != 1) return false;
  }
  return true;
}

RoundTrip::RoundTrip() : process_(fork_process(answer)), buffer_(kBytesMax) {}

std::optional<double> RoundTrip::seconds(std::size_t message, std::size_t answer) {
  const std::array<std::uint64_t, 2> sizes{std::clamp(message, kBytesMin, kBytesMax),
                                           std::clamp(answer, kBytesMin, kBytesMax)};
  std::memcpy(buffer_.data(), sizes.data(), sizeof sizes);
  const SteadyClock clock;
  const double start = clock.seconds();
  if (!send_all(process_.socket(), buffer_.data(), sizes[0]) ||
      !receive_all(process_.socket(), buffer_.data(), sizes[1]))
    return std::nullopt;
  return clock.seconds() - start;
}

}  // namespace rcb::bench
