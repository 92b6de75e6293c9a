#include "client/launch/job/job.hpp"

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <string_view>
#include <vector>

#include <fcntl.h>
#include <fmt/format.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include "client/launch/job/environment.hpp"
#include "common/base/child.hpp"
#include "common/files/descriptor.hpp"
#include "common/files/paths.hpp"

namespace rcb::launch {
namespace {

constexpr int kKillRoundsMax = 500;  // pauses of 10 ms

std::vector<char*> pointers(std::vector<std::string>& strings) {
  std::vector<char*> list;
  for (std::string& text : strings) list.push_back(text.data());
  list.push_back(nullptr);
  return list;
}

// Kills those children of this process that are in the session or about to begin it, orphaned ranks too, since this
// process is their reaper. True if there were any. Allocates nothing, since a lack of memory may be why the job is to
// end.
bool kill_children_in(pid_t session) {
  char path[64];
  std::snprintf(path, sizeof path, "/proc/self/task/%d/children", static_cast<int>(getpid()));
  const Descriptor file(open(path, O_RDONLY | O_CLOEXEC));
  bool found = false;
  pid_t pid = 0;
  char bytes[4096];
  for (ssize_t got = 0; file.open() && (got = read(file.get(), bytes, sizeof bytes)) > 0;)
    for (ssize_t i = 0; i < got; ++i) {
      if (bytes[i] >= '0' && bytes[i] <= '9') {
        pid = 10 * pid + (bytes[i] - '0');
        continue;
      }
      if (pid > 0 && (pid == session || getsid(pid) == session)) found = ::kill(pid, SIGKILL) == 0 || found;
      pid = 0;
    }
  return found;
}

JobEnd ending(int status) {
  if (WIFSIGNALED(status)) return {false, fmt::format("signal {}", WTERMSIG(status))};
  return {WEXITSTATUS(status) == 0, fmt::format("exit code {}", WEXITSTATUS(status))};
}

}  // namespace

Job::Job(JobSpec spec, std::string fallback, int output_fd)
    : spec_(std::move(spec)), fallback_(std::move(fallback)), output_fd_(output_fd) {}

Job::~Job() { kill(); }

Status Job::start(bool restarted) {
  keep_ended_children();
  folder_.reset();
  address_.clear();
  wait_status_.reset();
  auto folder = JobFolder::make(fallback_, spec_.ranks);
  if (!folder.ok()) return folder.status();
  folder_.emplace(std::move(*folder));
  folder_->sign({.process = ProcessId::self(), .endpoint = spec_.endpoint, .data_dir = spec_.data_dir});
  spec_.folder = folder_->path();
  spec_.memory_in_folder = folder_->holds_memory();
  auto arguments = mpirun_arguments(spec_);
  if (!arguments) return arguments.status();
  std::vector<std::string> environment = job_environment(spec_, restarted);
  const std::vector<char*> argv = pointers(*arguments);
  const std::vector<char*> envp = pointers(environment);
  const pid_t parent = getpid();
  pid_ = fork();
  if (pid_ < 0) return {Code::io_error, fmt::format("mpirun can't be started: {}", std::strerror(errno))};
  if (pid_ == 0) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (getppid() != parent) _exit(127);
    setsid();  // by which kill() knows what belongs to the job
    const int null_fd = open("/dev/null", O_RDONLY);
    if (dup2(null_fd, STDIN_FILENO) < 0 || dup2(output_fd_, STDOUT_FILENO) < 0 || dup2(output_fd_, STDERR_FILENO) < 0)
      _exit(127);
    close_range(3, ~0U, 0);
    sigset_t none;
    sigemptyset(&none);
    sigprocmask(SIG_SETMASK, &none, nullptr);
    // What the starter ignores is its own business; this process ignores SIGXFSZ on purpose, and so do the ranks.
    for (int number = 1; number < NSIG; ++number)
      if (number != SIGXFSZ) signal(number, SIG_DFL);
    execve(argv[0], argv.data(), envp.data());
    _exit(127);
  }
  session_ = pid_;
  return {};
}

std::string Job::address() {
  if (!address_.empty() || !folder_) return address_;
  std::ifstream in(join_path(folder_->path(), kReadyFile));
  for (std::string line; std::getline(in, line);)
    if (!line.starts_with("unix:") && address_.empty()) address_ = line;
  return address_;
}

bool Job::ready() const { return folder_ && access(join_path(folder_->path(), kReadyFile).c_str(), F_OK) == 0; }

std::optional<JobEnd> Job::poll() {
  int status = 0;
  while (pid_ > 0) {
    const pid_t ended = waitpid(-1, &status, WNOHANG);
    if (ended < 0 && errno == EINTR) continue;
    if (ended <= 0) return std::nullopt;
    if (ended != pid_) continue;  // an orphaned rank, or another's child
    pid_ = -1;
    wait_status_ = status;
  }
  return wait_status_ ? std::optional(ending(*wait_status_)) : std::nullopt;
}

void Job::kill() {
  if (pid_ > 0) ::kill(-pid_, SIGKILL);
  if (pid_ > 0) ::kill(pid_, SIGKILL);
  pid_ = -1;
  // mpirun gives each rank a process group of its own, so ranks are found as orphans that this process has adopted. The
  // number of rounds is limited, since a process that hangs in the kernel can't be waited for.
  for (int round = 0; session_ > 0 && round < kKillRoundsMax; ++round) {
    const bool found = kill_children_in(session_);
    while (waitpid(-1, nullptr, WNOHANG) > 0) continue;
    if (!found) break;
    usleep(10'000);
  }
  session_ = -1;
  wait_status_.reset();
  folder_.reset();
}

}  // namespace rcb::launch
