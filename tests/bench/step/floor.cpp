#include "tests/bench/step/floor.hpp"

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstring>

#include <poll.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

namespace rcb::bench {
namespace {

constexpr int kBufferBytes = 1 << 20;
constexpr std::size_t kChunkBytes = std::size_t{1} << 20U;
constexpr int kPollMilliseconds = 10'000;

[[noreturn]] void receive(int socket, std::size_t bytes) {
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  std::vector<std::byte> memory(bytes);
  while (true) {
    for (std::size_t have = 0; have < bytes;) {
      const ssize_t got = ::recv(socket, memory.data() + have, std::min(bytes - have, kChunkBytes), 0);
      if (got <= 0) ::_exit(0);
      have += static_cast<std::size_t>(got);
    }
    const char done = 1;
    if (::send(socket, &done, 1, MSG_NOSIGNAL) != 1) ::_exit(0);
  }
}

// Copies its bytes each time it is asked to.
[[noreturn]] void copy(int socket, const std::byte* from, std::size_t bytes) {
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  std::vector<std::byte> memory(bytes);
  char word = 0;
  while (::recv(socket, &word, 1, 0) == 1) {
    std::memcpy(memory.data(), from, bytes);
    // What it copied is of use to somebody, as far as the compiler can tell.
    asm volatile("" : : "r"(memory.data()) : "memory");
    if (::send(socket, &word, 1, MSG_NOSIGNAL) != 1) break;
  }
  ::_exit(0);
}

}  // namespace

Floor::Floor(Kind kind, std::vector<std::size_t> bytes) : kind_(kind) {
  for (const std::size_t each : bytes) shared_bytes_ += kind == Kind::memory ? each : 0;
  if (shared_bytes_ > 0) {
    void* const at = ::mmap(nullptr, shared_bytes_, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    shared_ = at == MAP_FAILED ? nullptr : static_cast<std::byte*>(at);
    if (shared_ == nullptr) return;
  }
  const std::byte* share = shared_;
  for (const std::size_t each : bytes) {
    int pair[2] = {-1, -1};
    if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair) != 0) return;
    ::setsockopt(pair[0], SOL_SOCKET, SO_SNDBUF, &kBufferBytes, sizeof kBufferBytes);
    const pid_t child = ::fork();
    if (child == 0) {
      // Else this process would keep the others' sockets open.
      ::close_range(STDERR_FILENO + 1, static_cast<unsigned>(pair[1]) - 1, 0);
      ::close_range(static_cast<unsigned>(pair[1]) + 1, ~0U, 0);
      if (kind == Kind::memory) copy(pair[1], share, each);
      receive(pair[1], each);
    }
    if (kind == Kind::memory) share += each;
    ::close(pair[1]);
    receivers_.push_back({pair[0], child, each});
  }
}

Floor::~Floor() {
  for (const Receiver& receiver : receivers_) ::close(receiver.socket);
  for (const Receiver& receiver : receivers_)
    if (receiver.process > 0) ::waitpid(receiver.process, nullptr, 0);
  if (shared_ != nullptr) ::munmap(shared_, shared_bytes_);
}

void Floor::load(const std::byte* from) {
  if (shared_ != nullptr) std::memcpy(shared_, from, shared_bytes_);
}

bool Floor::copied() {
  char word = 1;
  for (const Receiver& receiver : receivers_)
    if (::send(receiver.socket, &word, 1, MSG_NOSIGNAL) != 1) return false;
  for (const Receiver& receiver : receivers_)
    if (::recv(receiver.socket, &word, 1, 0) != 1) return false;
  return !receivers_.empty();
}

bool Floor::send(const std::byte* from) {
  if (kind_ == Kind::memory) return copied();
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
      const ssize_t sent =
          ::send(receivers_[r].socket, rests[r].at, std::min(rests[r].bytes, kChunkBytes), MSG_DONTWAIT | MSG_NOSIGNAL);
      if (sent < 0 && errno != EAGAIN) return false;
      if (sent > 0) {
        rests[r].at += sent;
        rests[r].bytes -= static_cast<std::size_t>(sent);
        moved = true;
      }
      if (rests[r].bytes == 0) continue;
      unfinished = true;
      full.push_back({receivers_[r].socket, POLLOUT, 0});
    }
    if (unfinished && !moved && ::poll(full.data(), full.size(), kPollMilliseconds) <= 0) return false;
  }
  for (const Receiver& receiver : receivers_) {
    char done = 0;
    if (receiver.bytes > 0 && ::recv(receiver.socket, &done, 1, 0) != 1) return false;
  }
  return true;
}

}  // namespace rcb::bench
