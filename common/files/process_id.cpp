#include "common/files/process_id.hpp"

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <sstream>

#include <fmt/format.h>
#include <unistd.h>

namespace rcb {
namespace {

constexpr int kStartField = 22;  // field of /proc/PID/stat, counted from 1
constexpr int kStateField = 3;   // the field after the program's name

}  // namespace

ProcessId ProcessId::self() { return of(::getpid()); }

ProcessId ProcessId::of(pid_t pid) {
  ProcessId id{pid, 0};
  std::ifstream in(fmt::format("/proc/{}/stat", pid));
  std::string line;
  std::getline(in, line);
  // The program's name is in parentheses, and may itself contain spaces and parentheses.
  const std::size_t name_end = line.rfind(')');
  if (name_end == std::string::npos) return id;
  std::istringstream fields(line.substr(name_end + 1));
  std::string skipped;
  for (int field = kStateField; field < kStartField; ++field) fields >> skipped;
  fields >> id.start;
  return id;
}

std::string ProcessId::text() const { return fmt::format("{}.{}", pid, start); }

ProcessId ProcessId::parse(const std::string& text) {
  int pid = -1;
  unsigned long long start = 0;
  char more = 0;
  if (std::sscanf(text.c_str(), "%d.%llu%c", &pid, &start, &more) != 2 || pid <= 0) return {};
  return {pid, start};
}

std::string process_space() {
  std::string boot;
  std::ifstream("/proc/sys/kernel/random/boot_id") >> boot;
  std::error_code fault;
  const std::string space = std::filesystem::read_symlink("/proc/self/ns/pid", fault).string();
  return boot.empty() || space.empty() ? "" : fmt::format("{} {}", boot, space);
}

}  // namespace rcb
