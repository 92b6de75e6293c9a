#include "client/launch/supervisor.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <functional>

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <signal.h>
#include <sys/file.h>
#include <sys/prctl.h>
#include <sys/signalfd.h>
#include <sys/stat.h>
#include <unistd.h>

#include "client/launch/job.hpp"
#include "client/launch/log_tail.hpp"
#include "client/launch/reach.hpp"
#include "common/base/clock.hpp"
#include "common/base/paths.hpp"

namespace rcb::launch {
namespace {

constexpr double kProbeSeconds = 0.05;
constexpr double kQuickSeconds = 10;  // a job that lived shorter failed quickly
constexpr int kQuickFailuresMax = 5;
constexpr double kBackoffFirstSeconds = 0.5;
constexpr double kBackoffMaxSeconds = 30;
constexpr double kStopSeconds = 20;
constexpr std::uint64_t kLogBytesMax = 16 << 20;

// The endpoint that a supervisor left in its lock.
std::string lock_holder(const std::string& path) {
  std::string endpoint;
  std::ifstream(path) >> endpoint;
  return endpoint;
}

class Supervisor {
 public:
  explicit Supervisor(const SuperviseOptions& options)
      : options_(options),
        log_path_(launch::log_path(options.data_dir)),
        marker_(join_path(options.data_dir, kCleanShutdownFile)) {}
  ~Supervisor();

  Status run();

 private:
  enum class Event { none, child, stop };

  Status open();
  Status await_first_answer(Job& job);
  Status keep(Job& job);
  Status restart(Job& job, const std::string& end);
  void stop(Job& job);
  Event wait(double seconds);
  std::string reason(const std::string& end) const;
  void note(const std::string& text) const;
  void notify(const Status& status) const;
  Status start(Job& job, bool restarted);
  bool left_marker() const { return std::filesystem::exists(marker_); }

  SuperviseOptions options_;
  std::string log_path_;
  std::string marker_;
  SteadyClock clock_;
  int log_fd_ = -1;
  int lock_fd_ = -1;
  int signal_fd_ = -1;
  sigset_t signals_before_{};
  std::uint64_t log_from_ = 0;
  double started_ = 0;
  int quick_failures_ = 0;
  bool stopping_ = false;
};

Supervisor::~Supervisor() {
  for (const int fd : {log_fd_, lock_fd_, signal_fd_})
    if (fd >= 0) close(fd);
  if (signal_fd_ >= 0) sigprocmask(SIG_SETMASK, &signals_before_, nullptr);
}

Status Supervisor::open() {
  if (Status status = make_directory(options_.data_dir); !status) return status;
  const std::string lock = join_path(options_.data_dir, kLaunchLockFile);
  lock_fd_ = ::open(lock.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
  if (lock_fd_ < 0) return {Code::io_error, fmt::format("{}: {}", lock, std::strerror(errno))};
  if (flock(lock_fd_, LOCK_EX | LOCK_NB) != 0)
    return {Code::already_exists,
            fmt::format("the data directory {} is in use by the service {}", options_.data_dir, lock_holder(lock)),
            "stop that one (rcbctl down), or name another --data-dir"};
  if (ftruncate(lock_fd_, 0) != 0 || dprintf(lock_fd_, "%s %d\n", options_.endpoint.c_str(), getpid()) < 0)
    return {Code::io_error, fmt::format("{}: {}", lock, std::strerror(errno))};
  std::error_code error;
  if (file_bytes(log_path_) > kLogBytesMax) std::filesystem::rename(log_path_, log_path_ + ".1", error);
  log_fd_ = ::open(log_path_.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
  if (log_fd_ < 0) return {Code::io_error, fmt::format("{}: {}", log_path_, std::strerror(errno))};
  sigset_t set;
  sigemptyset(&set);
  for (const int number : {SIGCHLD, SIGTERM, SIGINT, SIGHUP}) sigaddset(&set, number);
  sigprocmask(SIG_BLOCK, &set, &signals_before_);
  signal_fd_ = signalfd(-1, &set, SFD_CLOEXEC | SFD_NONBLOCK);
  if (signal_fd_ < 0) return {Code::internal, fmt::format("signalfd: {}", std::strerror(errno))};
  prctl(PR_SET_NAME, kSupervisorName.data());
  if (prctl(PR_SET_CHILD_SUBREAPER, 1) != 0)
    return {Code::internal, fmt::format("child subreaper: {}", std::strerror(errno))};
  return {};
}

Status Supervisor::run() {
  if (Status status = open(); !status) {
    notify(status);
    return status;
  }
  const std::string shm =
      fmt::format("/dev/shm/rcbd-{}-{:016x}", geteuid(), std::hash<std::string>{}(options_.data_dir));
  Job job({.endpoint = options_.endpoint,
           .data_dir = options_.data_dir,
           .ranks = options_.ranks,
           .shm_dir = shm,
           .service_arguments = options_.service_arguments},
          join_path(options_.data_dir, "tmp"), log_fd_);
  Status status = start(job, false);
  if (status) status = await_first_answer(job);
  if (!status) {
    job.kill();
    notify(status);
    return status;
  }
  if (!stopping_) {
    notify({});
    status = keep(job);
  }
  job.kill();
  if (options_.endpoint.starts_with("unix:")) {
    const std::string socket = options_.endpoint.substr(5);
    unlink(socket.c_str());
    for (int rank = 0; rank < options_.ranks; ++rank) unlink(fmt::format("{}.{}", socket, rank).c_str());
  }
  note(status ? "the service has ended" : "given up: " + status.message());
  return status;
}

Status Supervisor::start(Job& job, bool restarted) {
  std::error_code ignored;
  std::filesystem::remove(marker_, ignored);
  note(fmt::format("{} {} ranks on {}", restarted ? "starting again" : "starting", options_.ranks, options_.endpoint));
  log_from_ = file_bytes(log_path_);
  started_ = clock_.seconds();
  return job.start(restarted);
}

// Ok when it answers or a stop was asked for (stopping_).
Status Supervisor::await_first_answer(Job& job) {
  const double deadline = clock_.seconds() + options_.ready_seconds;
  while (clock_.seconds() < deadline) {
    if (wait(kProbeSeconds) == Event::stop) {
      stopping_ = true;
      return {};
    }
    if (const auto end = job.poll()) return {Code::aborted, reason(*end), "the whole log: " + log_path_};
    if (auto client = reach(options_.endpoint, "rcbctl up", 1);
        client || client.status().code() == Code::not_authorised)
      return {};
  }
  return {Code::deadline_exceeded,
          fmt::format("the service did not answer within {} s of its start", options_.ready_seconds),
          "its log: " + log_path_};
}

// Until the service ends for good.
Status Supervisor::keep(Job& job) {
  for (;;) {
    if (wait(-1) == Event::stop) {
      stop(job);
      return {};
    }
    const auto end = job.poll();
    if (!end) continue;
    if (left_marker()) return {};
    if (options_.embedded) {
      // The starter reads the log first; then its lifeline ends.
      while (wait(-1) != Event::stop) continue;
      return {};
    }
    if (Status status = restart(job, *end); !status || stopping_) return status;
  }
}

Status Supervisor::restart(Job& job, const std::string& end) {
  quick_failures_ = clock_.seconds() - started_ < kQuickSeconds ? quick_failures_ + 1 : 1;
  if (quick_failures_ > kQuickFailuresMax)
    return {Code::aborted, fmt::format("{} failures in a row; {}", quick_failures_, reason(end)),
            "the whole log: " + log_path_};
  double backoff = kBackoffFirstSeconds;
  for (int i = 1; i < quick_failures_; ++i) backoff = std::min(backoff * 2, kBackoffMaxSeconds);
  note(fmt::format("the service died ({}); it is started again in {} s", end, backoff));
  job.kill();
  const double due = clock_.seconds() + backoff;
  for (double left = backoff; left > 0; left = due - clock_.seconds())
    if (wait(left) == Event::stop) {
      stopping_ = true;
      return {};
    }
  return start(job, true);
}

// A clean end within the deadline; run() kills what is left after it.
void Supervisor::stop(Job& job) {
  if (options_.embedded) return;  // nothing in it lasts
  note("stopping");
  const double deadline = clock_.seconds() + kStopSeconds;
  auto client = reach(options_.endpoint, "rcbctl up", 2);
  if (!client || !client->shutdown_service()) return;
  while (job.running() && clock_.seconds() < deadline) {
    (void)wait(0.1);
    if (job.poll()) return;
  }
}

// Sleeps until a child ended, a stop was asked for, or the time is over (negative: none).
Supervisor::Event Supervisor::wait(double seconds) {
  pollfd fds[2] = {{signal_fd_, POLLIN, 0}, {options_.lifeline_fd, POLLIN, 0}};
  const int timeout_ms = seconds < 0 ? -1 : static_cast<int>(seconds * 1000) + 1;
  if (poll(fds, options_.lifeline_fd >= 0 ? 2 : 1, timeout_ms) <= 0) return Event::none;
  Event event = Event::none;
  signalfd_siginfo info{};
  while (read(signal_fd_, &info, sizeof info) == sizeof info) {
    if (info.ssi_signo == SIGCHLD) event = event == Event::none ? Event::child : event;
    if (info.ssi_signo == SIGTERM || info.ssi_signo == SIGINT) event = Event::stop;
  }
  if (options_.lifeline_fd >= 0 && fds[1].revents != 0) {
    char byte = 0;
    if (read(options_.lifeline_fd, &byte, 1) <= 0) return Event::stop;
    options_.lifeline_fd = -1;
  }
  return event;
}

std::string Supervisor::reason(const std::string& end) const {
  const std::string tail = log_tail(log_path_, log_from_);
  return fmt::format("the service ended ({}){}", end, tail.empty() ? "" : ":\n" + tail);
}

// A line of the supervisor's own in the log.
void Supervisor::note(const std::string& text) const {
  if (log_fd_ < 0) return;
  const std::time_t now = std::time(nullptr);
  std::tm utc{};
  gmtime_r(&now, &utc);
  char stamp[32] = {};
  std::strftime(stamp, sizeof stamp, "%Y-%m-%dT%H:%M:%SZ", &utc);
  dprintf(log_fd_, "%s", fmt::format("{} rcbctl up: {}\n", stamp, text).c_str());
}

void Supervisor::notify(const Status& status) const {
  if (options_.notify_fd < 0) return;
  std::string text(1, status ? kReady : kFailed);
  if (!status)
    for (const std::string& field : {std::string(code_name(status.code())), status.message(), status.hint()})
      text.append(field).push_back('\0');
  // A starter that is gone needs no answer.
  if (write(options_.notify_fd, text.data(), text.size()) < 0) note("the starter has gone");
}

}  // namespace

std::string log_path(const std::string& data_dir) { return join_path(data_dir, kLogFile); }

Status supervise(const SuperviseOptions& options) { return Supervisor(options).run(); }

}  // namespace rcb::launch
