#include "client/launch/job/processes.hpp"

#include <cstdlib>
#include <fstream>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <poll.h>
#include <signal.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "common/wire/field_reader.hpp"

namespace rcb::launch {
ProcessInfo process_info(pid_t pid) {
  ProcessInfo info;
  std::ifstream in(fmt::format("/proc/{}/status", pid));
  for (std::string line; std::getline(in, line);) {
    if (line.starts_with("Name:\t")) info.name = line.substr(6);
    if (line.starts_with("PPid:\t")) info.parent = std::atoi(line.c_str() + 6);
  }
  return info;
}

ProcessId rank0_of(client::Client& client, double deadline_seconds) {
  const auto status = client.call("status", "{}", deadline_seconds);
  if (!status) return {};
  const auto json = nlohmann::json::parse(status->json, nullptr, false);
  if (!json.is_object() || !json.contains("process")) return {};
  wire::FieldReader fields(json["process"]);
  const std::string space = fields.text("space");
  const ProcessId rank0 = ProcessId::parse(fields.text("id"));
  return fields.status().ok() && !space.empty() && space == process_space() && rank0.exists() ? rank0 : ProcessId{};
}

Process::Process(const ProcessId& id) : id_(id), handle_(static_cast<int>(syscall(SYS_pidfd_open, id.pid, 0))) {
  // The number may have been reused before the handle was opened.
  if (handle_.open() && !id_.exists()) handle_.close();
}

bool Process::ended(double seconds) const {
  if (!handle_.open()) return !id_.exists();
  pollfd fd{handle_.get(), POLLIN, 0};
  return poll(&fd, 1, static_cast<int>(seconds * 1000)) > 0;
}

void Process::signal(int number) const {
  if (handle_.open()) syscall(SYS_pidfd_send_signal, handle_.get(), number, nullptr, 0);
}

}  // namespace rcb::launch
