#include "tests/bench/floor.hpp"

#include <algorithm>
#include <cerrno>
#include <csignal>

#include <poll.h>
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

}  // namespace

Floor::Floor(std::vector<std::size_t> bytes) {
  for (const std::size_t each : bytes) {
    int pair[2] = {-1, -1};
    if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair) != 0) return;
    ::setsockopt(pair[0], SOL_SOCKET, SO_SNDBUF, &kBufferBytes, sizeof kBufferBytes);
    const pid_t child = ::fork();
    if (child == 0) {
      for (const Receiver& receiver : receivers_) ::close(receiver.socket);
      ::close(pair[0]);
      receive(pair[1], each);
    }
    ::close(pair[1]);
    receivers_.push_back({pair[0], child, each});
  }
}

Floor::~Floor() {
  for (const Receiver& receiver : receivers_) ::close(receiver.socket);
  for (const Receiver& receiver : receivers_)
    if (receiver.process > 0) ::waitpid(receiver.process, nullptr, 0);
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
