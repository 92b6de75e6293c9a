#include "server/program/job.hpp"

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <string_view>

#include <execinfo.h>
#include <fcntl.h>
#include <fmt/ranges.h>
#include <spdlog/spdlog.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <unistd.h>

#include "common/files/descriptor.hpp"
#include "common/files/paths.hpp"
#include "common/wire/limits.hpp"
#include "server/net/files/socket_name.hpp"

namespace rcb::server {

std::string job_folder() {
  const char* folder = std::getenv(kJobFolderVariable);
  return folder != nullptr && folder[0] == '/' ? folder : "/tmp";
}

namespace {

char g_job_folder[256];
bool g_in_order = false;

constexpr int kFaults[] = {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT};
char g_fault_line[64];

// Only what is safe in a signal handler: the memory may be destroyed, and any lock be held.
void on_fault(int number) {
  constexpr unsigned kSeconds = 2;
  constexpr int kFramesMax = 64;
  ::signal(SIGALRM, SIG_DFL);
  sigset_t alarm_alone;
  sigemptyset(&alarm_alone);
  sigaddset(&alarm_alone, SIGALRM);
  ::pthread_sigmask(SIG_UNBLOCK, &alarm_alone, nullptr);
  ::alarm(kSeconds);  // ends the process should anything below wait
  char line[] = "signal 00; it ends\n";
  line[7] = static_cast<char>('0' + number / 10);
  line[8] = static_cast<char>('0' + number % 10);
  void* frames[kFramesMax];
  [[maybe_unused]] ssize_t written = ::write(STDERR_FILENO, g_fault_line, std::strlen(g_fault_line));
  written = ::write(STDERR_FILENO, line, sizeof line - 1);
  ::backtrace_symbols_fd(frames, ::backtrace(frames, kFramesMax), STDERR_FILENO);
  ::signal(number, SIG_DFL);
  ::raise(number);
}

void on_hangup(int) {
  remove_traces();
  ::kill(::getpid(), SIGKILL);
}

// Checks the folder's name first, since the folder is later removed with everything in it.
void remember_job_folder() {
  const std::string path = job_folder();
  if (path.size() < sizeof g_job_folder && path.substr(path.rfind('/') + 1).starts_with(kJobFolderPrefix))
    path.copy(g_job_folder, path.size());
}

}  // namespace

void remove_traces() noexcept {
  net::SocketName::remove_all();
  if (g_job_folder[0] == '\0' || ::_Fork() != 0) return;
  // This removes file names only: what ranks that still run have mapped stays theirs until they end.
  static char program[] = "/bin/rm";
  static char flags[] = "-rf";
  char* const arguments[] = {program, flags, g_job_folder, nullptr};
  ::execv(program, arguments);
  ::_exit(127);
}

void end_with_mpirun(int rank) {
  if (rank == 0) remember_job_folder();
  struct sigaction action {};
  action.sa_handler = on_hangup;
  sigfillset(&action.sa_mask);
  ::sigaction(SIGHUP, &action, nullptr);
  // If MPI is the first to notice that mpirun is gone, it ends the process by exit().
  std::atexit([] {
    if (!g_in_order) remove_traces();
  });
  // The kernel also sends SIGHUP to a stopped process that becomes an orphan when mpirun dies.
  ::prctl(PR_SET_PDEATHSIG, SIGHUP);
}

void end_at_faults(int rank) {
  std::snprintf(g_fault_line, sizeof g_fault_line, "rcbd: rank %d (pid %d): ", rank, static_cast<int>(::getpid()));
  void* frame = nullptr;
  ::backtrace(&frame, 1);  // loads what it needs, which allocates
  struct sigaction action {};
  action.sa_handler = on_fault;
  action.sa_flags = SA_NODEFER;
  for (const int number : kFaults) ::sigaction(number, &action, nullptr);
}

void raise_open_files_limit() {
  rlimit files{};
  if (::getrlimit(RLIMIT_NOFILE, &files) != 0) return;
  files.rlim_cur = files.rlim_max;
  ::setrlimit(RLIMIT_NOFILE, &files);
}

ConnectionLimits connection_limits(int ranks) {
  constexpr int kFiles = 24;  // listeners, logs, files that commands read and write
  rlimit files{};
  std::error_code error;
  const auto open = static_cast<std::int64_t>(names_in("/proc/self/fd", error).size());
  if (error || ::getrlimit(RLIMIT_NOFILE, &files) != 0) return {wire::kSessionsMax, wire::kBeforeHelloMax};
  const auto most = static_cast<std::int64_t>(std::min<rlim_t>(files.rlim_cur, 1U << 20U));
  const std::int64_t left = std::max<std::int64_t>(most - open - ranks - kFiles, 0);
  const auto sessions = std::clamp<std::int64_t>(left / 3, 2, wire::kSessionsMax);
  // As many data connections as sessions; the rest is for those at four listeners that haven't said hello.
  const auto waiting = std::clamp<std::int64_t>((left - 2 * sessions) / 5, 1, std::int64_t{wire::kBeforeHelloMax});
  const ConnectionLimits limits{static_cast<int>(sessions), static_cast<std::size_t>(waiting)};
  if (limits.sessions < wire::kSessionsMax)
    spdlog::warn("{} sessions at most, since only {} files may be open (ulimit -n)", limits.sessions, most);
  return limits;
}

void say_ready(const std::vector<std::string>& endpoints) {
  if (g_job_folder[0] == '\0') return;
  const std::string path = join_path(g_job_folder, kReadyFile);
  const std::string begun = path + ".new";  // renamed once it is complete
  const std::string text = fmt::format("{}\n", fmt::join(endpoints, "\n"));
  const Descriptor file(::open(begun.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600));
  // Without its text, where there is no room for that, it still tells that the service is up.
  if (file.open() && ::write(file.get(), text.data(), text.size()) != static_cast<ssize_t>(text.size()))
    (void)!::ftruncate(file.get(), 0);
  if (!file.open() || ::rename(begun.c_str(), path.c_str()) != 0)
    spdlog::error("can't make {}: {}; the launcher will not know that the service is up", path, std::strerror(errno));
}

void end_in_order() { g_in_order = true; }

}  // namespace rcb::server
