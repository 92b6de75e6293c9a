#include "server/job.hpp"

#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <string>
#include <string_view>

#include <fcntl.h>
#include <spdlog/spdlog.h>
#include <sys/prctl.h>
#include <unistd.h>

#include "common/base/paths.hpp"
#include "server/net/socket_name.hpp"

namespace rcb::server {
namespace {

char g_job_folder[256];
bool g_in_order = false;

void on_hangup(int) {
  remove_traces();
  ::kill(::getpid(), SIGKILL);
}

// Its name is looked at, since it is removed with all that is in it.
void remember_job_folder() {
  const char* folder = std::getenv(kJobFolderVariable);
  const std::string_view path = folder != nullptr ? folder : "";
  if (path.starts_with('/') && path.size() < sizeof g_job_folder &&
      path.substr(path.rfind('/') + 1).starts_with(kJobFolderPrefix))
    path.copy(g_job_folder, path.size());
}

}  // namespace

void remove_traces() noexcept {
  net::SocketName::remove_all();
  if (g_job_folder[0] == '\0' || ::_Fork() != 0) return;
  // Names alone: ranks that are about to end have their memory until then.
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
  // MPI ends the process by itself where it is the first to notice that mpirun is gone.
  std::atexit([] {
    if (!g_in_order) remove_traces();
  });
  // The kernel sends SIGHUP also to a stopped process that mpirun's death makes an orphan.
  ::prctl(PR_SET_PDEATHSIG, SIGHUP);
}

void say_ready() {
  if (g_job_folder[0] == '\0') return;
  const std::string path = join_path(g_job_folder, kReadyFile);
  const int file = ::open(path.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600);
  if (file < 0)
    spdlog::error("can't make {}: {}; the launcher will not know that the service is up", path, std::strerror(errno));
  else
    ::close(file);
}

void end_in_order() { g_in_order = true; }

}  // namespace rcb::server
