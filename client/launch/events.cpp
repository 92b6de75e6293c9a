#include "client/launch/events.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sys/signalfd.h>
#include <unistd.h>

#include "common/base/clock.hpp"

namespace rcb::launch {
namespace {

constexpr std::size_t kReadBytes = 64 * 1024;
constexpr int kReadsMax = 64;  // of the job's output, before other events are looked at

}  // namespace

Events::~Events() {
  if (signals_.open()) sigprocmask(SIG_SETMASK, &signals_before_, nullptr);
}

Status Events::open(int lifeline_fd) {
  lifeline_fd_ = lifeline_fd;
  buffer_.resize(kReadBytes);
  int ends[2];
  if (pipe2(ends, O_CLOEXEC) != 0) return {Code::internal, fmt::format("pipe: {}", std::strerror(errno))};
  to_read_ = Descriptor(ends[0]);
  to_write_ = Descriptor(ends[1]);
  fcntl(to_read_.get(), F_SETFL, O_NONBLOCK);
  sigset_t set;
  sigemptyset(&set);
  for (const int number : {SIGCHLD, SIGTERM, SIGINT}) sigaddset(&set, number);
  // One that is ignored would come through signalfd all the same.
  struct sigaction hangup {};
  if (sigaction(SIGHUP, nullptr, &hangup) != 0 || hangup.sa_handler != SIG_IGN) sigaddset(&set, SIGHUP);
  sigprocmask(SIG_BLOCK, &set, &signals_before_);
  signals_ = Descriptor(signalfd(-1, &set, SFD_CLOEXEC | SFD_NONBLOCK));
  if (!signals_.open()) return {Code::internal, fmt::format("signalfd: {}", std::strerror(errno))};
  return {};
}

Events::Event Events::read_signals() const {
  Event event = Event::none;
  signalfd_siginfo info{};
  while (read(signals_.get(), &info, sizeof info) == sizeof info) {
    if (info.ssi_signo != SIGCHLD)
      event = Event::stop;
    else if (event == Event::none)
      event = Event::child;
  }
  return event;
}

Events::Event Events::wait(double seconds, const OnOutput& on_output) {
  const SteadyClock clock;
  const double end = clock.seconds() + seconds;
  for (;;) {
    pollfd fds[3] = {{signals_.get(), POLLIN, 0}, {to_read_.get(), POLLIN, 0}, {lifeline_fd_, POLLIN, 0}};
    const double left = std::max(0.0, end - clock.seconds());
    if (poll(fds, 3, seconds < 0 ? -1 : static_cast<int>(left * 1000) + 1) <= 0) return Event::none;
    // First, since it may throw: a signal that had been read would be lost.
    if (fds[1].revents != 0) drain(on_output);
    const Event event = read_signals();
    if (lifeline_fd_ >= 0 && fds[2].revents != 0) {
      char byte = 0;
      if (read(lifeline_fd_, &byte, 1) <= 0) return Event::stop;
      lifeline_fd_ = -1;
    }
    if (event != Event::none) return event;
  }
}

void Events::drain(const OnOutput& on_output) {
  for (int i = 0; i < kReadsMax; ++i) {
    const ssize_t got = read(to_read_.get(), buffer_.data(), buffer_.size());
    if (got <= 0) return;
    on_output({buffer_.data(), static_cast<std::size_t>(got)});
  }
}

}  // namespace rcb::launch
