#include "client/launch/programs.hpp"

#include <algorithm>
#include <cstdlib>
#include <filesystem>

#include <fmt/format.h>
#include <sched.h>
#include <unistd.h>

namespace rcb::launch {
namespace {

namespace fs = std::filesystem;

constexpr int kDefaultRanksMax = 8;

bool runnable(const fs::path& path) {
  std::error_code error;
  return fs::is_regular_file(path, error) && access(path.c_str(), X_OK) == 0;
}

// The program of that name in a colon-separated list of folders; empty if none.
std::string search(const std::string& folders, const std::string& program) {
  std::size_t begin = 0;
  while (begin <= folders.size()) {
    const std::size_t end = std::min(folders.find(':', begin), folders.size());
    const std::string folder = folders.substr(begin, end - begin);
    const fs::path path = fs::path(folder.empty() ? "." : folder) / program;
    if (runnable(path)) return fs::absolute(path).string();
    begin = end + 1;
  }
  return {};
}

std::string path_variable() {
  const char* path = std::getenv("PATH");
  return path != nullptr ? path : "/usr/local/bin:/usr/bin:/bin";
}

}  // namespace

int default_ranks() {
  cpu_set_t set;
  CPU_ZERO(&set);
  const int cores = sched_getaffinity(0, sizeof set, &set) == 0 ? CPU_COUNT(&set) : 1;
  return std::clamp(cores, 1, kDefaultRanksMax);
}

Result<std::string> find_in_path(const std::string& program) {
  const std::string found = search(path_variable(), program);
  if (found.empty())
    return Status(Code::not_found, program + " is not in PATH", "install Open MPI (Debian: apt install openmpi-bin)");
  return found;
}

Result<std::string> find_rcbd() {
  const char* named = std::getenv("RCBD_BIN_DIR");
  if (named != nullptr && *named != '\0') {
    const fs::path path = fs::path(named) / "rcbd";
    if (runnable(path)) return fs::absolute(path).string();
    return Status(Code::not_found, fmt::format("RCBD_BIN_DIR is {}, where there is no program rcbd", named),
                  "set it to the folder of rcbd, or unset it");
  }
  std::error_code error;
  const fs::path self = fs::read_symlink("/proc/self/exe", error);
  if (!error && runnable(self.parent_path() / "rcbd")) return (self.parent_path() / "rcbd").string();
  const std::string found = search(path_variable(), "rcbd");
  if (found.empty())
    return Status(Code::not_found, "rcbd was found neither beside this program nor in PATH",
                  "build it (target rcbd), or set RCBD_BIN_DIR to its folder");
  return found;
}

Result<std::vector<std::string>> mpirun_arguments(const JobSpec& spec) {
  auto mpirun = find_in_path("mpirun");
  if (!mpirun) return mpirun.status();
  std::vector<std::string> arguments{*mpirun, "--bind-to", "none", "--oversubscribe"};
  if (geteuid() == 0) arguments.emplace_back("--allow-run-as-root");
  arguments.insert(arguments.end(), {"--mca", "btl", "vader,self"});
  if (!spec.folder.empty()) arguments.insert(arguments.end(), {"--mca", "btl_vader_backing_directory", spec.folder});
  arguments.insert(arguments.end(), {"-n", std::to_string(spec.ranks)});
  if (!spec.command.empty()) {
    arguments.insert(arguments.end(), spec.command.begin(), spec.command.end());
    return arguments;
  }
  auto rcbd = find_rcbd();
  if (!rcbd) return rcbd.status();
  arguments.push_back(*rcbd);
  if (spec.endpoint.starts_with("unix:"))
    arguments.insert(arguments.end(), {"--socket", spec.endpoint.substr(5)});
  else
    arguments.insert(arguments.end(), {"--listen", spec.endpoint});
  arguments.insert(arguments.end(), {"--data-dir", spec.data_dir});
  arguments.insert(arguments.end(), spec.service_arguments.begin(), spec.service_arguments.end());
  return arguments;
}

}  // namespace rcb::launch
