// How a running service is stopped, and how one sees that it is gone.
#include <charconv>
#include <fstream>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <poll.h>
#include <signal.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "client/launch/launch.hpp"
#include "client/launch/reach.hpp"
#include "common/base/clock.hpp"
#include "common/base/paths.hpp"

namespace rcb::launch {
namespace {

constexpr double kForceSeconds = 30;
constexpr int kAncestorsMax = 2;  // mpirun and its supervisor

// A process by a handle that no later process of the same number can be mistaken for.
struct Process {
  pid_t pid = -1;
  int handle = -1;
  bool supervisor = false;
};

struct ProcessInfo {
  std::string name;
  pid_t parent = 0;
};

ProcessInfo process_info(pid_t pid) {
  ProcessInfo info;
  std::ifstream in(fmt::format("/proc/{}/status", pid));
  for (std::string line; std::getline(in, line);) {
    if (line.starts_with("Name:\t")) info.name = line.substr(6);
    if (line.starts_with("PPid:\t")) info.parent = std::atoi(line.c_str() + 6);
  }
  return info;
}

Process opened(pid_t pid, bool supervisor) {
  return {pid, static_cast<int>(syscall(SYS_pidfd_open, pid, 0)), supervisor};
}

// Rank 0, its mpirun and that one's supervisor, as far as they are of this machine.
std::vector<Process> processes_of(pid_t rank0) {
  std::vector<Process> list;
  if (rank0 <= 1 || !process_info(rank0).name.starts_with("rcbd")) return list;
  list.push_back(opened(rank0, false));
  pid_t pid = process_info(rank0).parent;
  for (int i = 0; i < kAncestorsMax && pid > 1; ++i) {
    const ProcessInfo info = process_info(pid);
    const bool mpirun = info.name == "mpirun" || info.name == "orterun" || info.name == "prterun";
    if (!mpirun && !(i > 0 && info.name == kSupervisorName)) break;
    list.push_back(opened(pid, !mpirun));
    pid = info.parent;
  }
  return list;
}

bool ended(const Process& process, double seconds) {
  if (process.handle < 0) return kill(process.pid, 0) != 0;
  pollfd fd{process.handle, POLLIN, 0};
  return poll(&fd, 1, static_cast<int>(seconds * 1000)) > 0;
}

// The service runs on this machine, so that its process ids mean something here.
bool is_local(const std::string& endpoint) {
  return endpoint.starts_with("unix:") || endpoint.starts_with("127.") || endpoint.starts_with("localhost:") ||
         endpoint.starts_with("[::1]:");
}

bool socket_gone(const std::string& endpoint) {
  if (!endpoint.starts_with("unix:")) return true;
  struct stat info {};
  return lstat(endpoint.c_str() + 5, &info) != 0;
}

// All processes and the socket are gone.
bool await_gone(const std::vector<Process>& processes, const std::string& endpoint, double seconds) {
  const SteadyClock clock;
  const double deadline = clock.seconds() + seconds;
  for (const Process& process : processes)
    while (!ended(process, 0.05))
      if (clock.seconds() > deadline) return false;
  while (!socket_gone(endpoint)) {
    if (clock.seconds() > deadline) return false;
    usleep(20'000);
  }
  return true;
}

Status stop(client::Client& client, std::vector<Process>& processes, double deadline_seconds) {
  const std::string endpoint = client.endpoint();
  auto status = client.call("status", "{}", deadline_seconds);
  if (status) {
    const auto json = nlohmann::json::parse(status->json, nullptr, false);
    if (json.is_object() && json.contains("pid") && json["pid"].is_number_integer() && is_local(endpoint))
      processes = processes_of(json["pid"].get<pid_t>());
  }
  const Status told = client.shutdown_service();
  // A service that ends may close the connection before its answer is read.
  if (!told && told.code() != Code::unavailable && told.code() != Code::deadline_exceeded) return told;
  if (await_gone(processes, endpoint, deadline_seconds)) return {};
  for (const Process& process : processes)
    if (process.supervisor) kill(process.pid, SIGTERM);
  if (await_gone(processes, endpoint, kForceSeconds)) return {};
  std::string pids;
  for (const Process& process : processes)
    if (!ended(process, 0)) pids += fmt::format(" {}", process.pid);
  return {Code::deadline_exceeded, fmt::format("the service at {} has not ended; processes:{}", endpoint, pids),
          "end them by hand (kill -9)"};
}

}  // namespace

Status stop_service(const std::string& endpoint, double deadline_seconds) {
  auto client = reach(endpoint, "rcbctl down");
  if (!client) return client.status();
  std::vector<Process> processes;
  const Status status = stop(*client, processes, deadline_seconds);
  for (const Process& process : processes)
    if (process.handle >= 0) close(process.handle);
  return status;
}

}  // namespace rcb::launch
