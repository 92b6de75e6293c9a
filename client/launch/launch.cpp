#include "client/launch/launch.hpp"

#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <utility>
#include <vector>

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include "client/launch/log_tail.hpp"
#include "common/base/clock.hpp"
#include "common/base/signals.hpp"
#include "common/files/lock_file.hpp"
#include "common/files/own_files.hpp"
#include "common/files/paths.hpp"

namespace rcb::launch {
namespace {

constexpr double kProgressSeconds = 0.5;
constexpr double kGraceSeconds = 15;  // beyond the supervisor's own deadline
constexpr double kEndSeconds = 30;
constexpr std::size_t kTemporaryPathMax = 60;
constexpr std::chrono::minutes kStartTime{2};
constexpr std::string_view kTemporaryPrefix = "rcb-embedded-";

// The pipes to the supervisor; atomic, since a signal handler uses them.
struct SupervisorPipes {
  std::atomic<int> lifeline_fd{-1};
  std::atomic<int> notify_fd{-1};
};
SupervisorPipes g_bond;

// Waits until the supervisor has ended: then read() finds the end of the pipe, which only the supervisor holds open.
// Safe in a signal handler.
void await_end(int notify_fd, int timeout_ms) {
  char bytes[256];
  pollfd fd{notify_fd, POLLIN, 0};
  while (poll(&fd, 1, timeout_ms) > 0 && read(notify_fd, bytes, sizeof bytes) > 0) continue;
}

// When the program is interrupted, its service is ended first.
void on_signal(int number) {
  const int lifeline_fd = g_bond.lifeline_fd.exchange(-1);
  const int notify_fd = g_bond.notify_fd.exchange(-1);
  if (lifeline_fd >= 0) {
    close(lifeline_fd);
    await_end(notify_fd, static_cast<int>(kEndSeconds * 1000));
  }
  signal(number, SIG_DFL);
  raise(number);
}

void guard_by_signals(int lifeline_fd, int notify_fd) {
  g_bond.notify_fd = notify_fd;
  g_bond.lifeline_fd = lifeline_fd;
  for (const int number : {SIGINT, SIGTERM, SIGHUP, SIGQUIT}) {
    struct sigaction action {};
    action.sa_handler = on_signal;
    sigfillset(&action.sa_mask);
    handle_unless_ignored(number, action);
  }
}

void unguard() {
  g_bond.lifeline_fd = -1;
  g_bond.notify_fd = -1;
}

struct Pipe {
  Descriptor read;
  Descriptor write;
};

Result<Pipe> make_pipe() {
  int ends[2];
  if (pipe2(ends, O_CLOEXEC) != 0) return Status(Code::io_error, fmt::format("pipe: {}", std::strerror(errno)));
  return Pipe{Descriptor(ends[0]), Descriptor(ends[1])};
}

// Runs in the child: leaves the starter's session, standard streams and open files.
[[noreturn]] void run_supervisor(SuperviseOptions options, int notify_fd, int lifeline_fd) {
  setsid();
  for (const int number : {SIGINT, SIGTERM, SIGQUIT}) signal(number, SIG_DFL);
  signal(SIGHUP, SIG_IGN);  // the terminal of the starter may go
  sigset_t none;            // what the starter blocks is its own business
  sigemptyset(&none);
  sigprocmask(SIG_SETMASK, &none, nullptr);
  signal(SIGPIPE, SIG_IGN);
  signal(SIGXFSZ, SIG_IGN);
  const int null_fd = open("/dev/null", O_RDWR);
  for (int fd = 0; fd < 3; ++fd) dup2(null_fd, fd);
  // The pipes may have any numbers, even 3 and 4: so move them up first.
  const int high_notify = fcntl(notify_fd, F_DUPFD, 5);
  const int high_lifeline = fcntl(lifeline_fd, F_DUPFD, 5);
  options.notify_fd = dup2(high_notify, 3);
  options.lifeline_fd = dup2(high_lifeline, 4);
  if (options.notify_fd < 0 || options.lifeline_fd < 0) _exit(1);  // no room for so many open files
  close_range(5, ~0U, 0);
  // Close-on-exec, so that the end of this process alone closes the pipe and tells the starter that all is done.
  for (const int fd : {3, 4}) fcntl(fd, F_SETFD, FD_CLOEXEC);
  if (chdir("/") != 0) _exit(1);
  const Status status = supervise(options);
  if (options.embedded) {
    std::error_code ignored;
    std::filesystem::remove_all(options.data_dir, ignored);
  }
  _exit(status ? 0 : 1);
}

Result<Supervised> fork_supervisor(const SuperviseOptions& options) {
  auto notify = make_pipe();
  if (!notify) return notify.status();
  auto lifeline = make_pipe();
  if (!lifeline) return lifeline.status();
  std::fflush(nullptr);
  // From here on an interruption goes through the handler, which ends the child if it exists already: it waits for the
  // end of `notify`, so it is held up until this process no longer has that open for writing.
  sigset_t all, before;
  sigfillset(&all);
  sigprocmask(SIG_SETMASK, &all, &before);
  guard_by_signals(lifeline->write.get(), notify->read.get());
  const pid_t child = fork();
  if (child == 0) {
    lifeline->write.close();
    notify->read.close();
    run_supervisor(options, notify->write.get(), lifeline->read.get());
  }
  const int reason = errno;
  notify->write.close();
  lifeline->read.close();
  sigprocmask(SIG_SETMASK, &before, nullptr);
  if (child < 0) {
    unguard();
    return Status(Code::io_error, fmt::format("fork: {}", std::strerror(reason)));
  }
  return Supervised{child, std::move(lifeline->write), std::move(notify->read)};
}

// Ends the supervisor and waits for it.
void end(Supervised& supervised) {
  unguard();
  supervised.lifeline.close();
  await_end(supervised.notify.get(), static_cast<int>(kEndSeconds * 1000));
  supervised.notify.close();
  waitpid(supervised.process, nullptr, WNOHANG);
}

Status failure_from(const std::string& text) {
  std::vector<std::string> fields;
  for (std::size_t begin = 1; begin < text.size();) {
    const std::size_t stop = std::min(text.find('\0', begin), text.size());
    fields.push_back(text.substr(begin, stop - begin));
    begin = stop + 1;
  }
  fields.resize(3);
  const Code code = code_from_name(fields[0]);
  return {code == Code::ok ? Code::internal : code, fields[1], fields[2]};
}

// What the supervisor reports about the start: ok if the service answers.
Status await_verdict(const Supervised& started, double deadline_seconds, const Progress& progress) {
  const SteadyClock clock;
  const double begin = clock.seconds();
  std::string text;
  for (;;) {
    const double waited = clock.seconds() - begin;
    if (waited > deadline_seconds) return {Code::deadline_exceeded, "the launcher did not say how the start went"};
    pollfd fd{started.notify.get(), POLLIN, 0};
    const int ready = poll(&fd, 1, static_cast<int>(kProgressSeconds * 1000));
    if (ready == 0 && progress) progress(waited);
    if (ready <= 0) continue;
    char bytes[4096];
    const ssize_t got = read(started.notify.get(), bytes, sizeof bytes);
    if (got > 0) text.append(bytes, static_cast<std::size_t>(got));
    if (!text.empty() && text[0] == kReady) return {};
    if (got > 0) continue;
    if (text.empty())
      return {Code::internal, "the launcher died while it started the service",
              "look at this shell's limits (ulimit -a): memory, stack, open files"};
    return failure_from(text);
  }
}

// Removes the folders of embedded services whose program and supervisor were killed at the same moment; nobody holds
// the locks in them.
void sweep_temporary(const std::string& parent) {
  std::error_code ignored;
  for (const std::string& name : names_in(parent, ignored)) {
    const std::string path = join_path(parent, name);
    if (!name.starts_with(kTemporaryPrefix) || !is_own_directory(path)) continue;
    const std::string lock_path = join_path(path, kLockFile);
    std::error_code fault;
    const auto written = std::filesystem::last_write_time(lock_path, fault);
    if (fault || decltype(written)::clock::now() - written < kStartTime) continue;  // it may just be starting
    if (const auto lock = LockFile::take(lock_path, ""); lock.ok()) std::filesystem::remove_all(path, fault);
  }
}

// A new folder whose path is short enough for a socket.
Result<std::string> temporary_directory() {
  const char* named = std::getenv("TMPDIR");
  std::string parent = named != nullptr && *named == '/' ? named : "/tmp";
  // A folder in which others could place files isn't safe for a service.
  if (parent.size() > kTemporaryPathMax || !check_parent_directory(parent)) parent = "/tmp";
  sweep_temporary(parent);
  std::string pattern = join_path(parent, fmt::format("{}XXXXXX", kTemporaryPrefix));
  if (mkdtemp(pattern.data()) == nullptr)
    return Status(Code::io_error, fmt::format("{}: no folder can be made: {}", parent, std::strerror(errno)),
                  "set TMPDIR to a folder that may be written");
  return pattern;
}

}  // namespace

Status start_detached(SuperviseOptions options, const Progress& progress) {
  options.embedded = false;
  auto started = fork_supervisor(options);
  if (!started) return started.status();
  const Status status = await_verdict(*started, options.ready_seconds + kGraceSeconds, progress);
  if (!status) {
    end(*started);
    return status;
  }
  unguard();
  const char bye = 'd';
  const bool told = write(started->lifeline.get(), &bye, 1) == 1;
  if (!told) return {Code::unavailable, "the service ended as soon as it had started", log_path(options.data_dir)};
  return {};
}

Result<Embedded> Embedded::start(int ranks, const Progress& progress) {
  Embedded service;
  auto directory = temporary_directory();
  if (!directory) return directory.status();
  service.directory_ = *directory;
  service.endpoint_ = "unix:" + join_path(*directory, "s");
  SuperviseOptions options;
  options.endpoint = service.endpoint_;
  options.data_dir = *directory;
  options.ranks = ranks;
  options.embedded = true;
  options.service_arguments = {"--local-files-below", "/"};  // the user's own, and ends with this program
  auto started = fork_supervisor(options);
  if (!started) {
    rmdir(directory->c_str());
    return started.status();
  }
  service.supervised_ = std::move(*started);
  if (Status status = await_verdict(service.supervised_, options.ready_seconds + kGraceSeconds, progress); !status)
    return status;
  return service;
}

Embedded::~Embedded() {
  if (!supervised_.lifeline.open()) return;
  end(supervised_);
  std::error_code ignored;
  std::filesystem::remove_all(directory_, ignored);  // if the supervisor couldn't
}

Status Embedded::explain(Status status) const {
  if (status.code() != Code::unavailable) return status;
  const std::string tail = log_tail(log_path(directory_));
  if (tail.empty()) return status;
  return {Code::internal, fmt::format("{}; the embedded service's log ends:\n{}", status.message(), tail),
          status.hint()};
}

}  // namespace rcb::launch
