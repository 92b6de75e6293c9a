#include "tests/bench/step/process_memory.hpp"

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <string_view>

#include <fmt/format.h>
#include <unistd.h>

namespace rcb::bench {
namespace {

constexpr auto kBetweenSamples = std::chrono::milliseconds(5);

std::string proc(pid_t pid, const char* file) { return fmt::format("/proc/{}/{}", pid, file); }

// The bytes of the lines "Name:   N kB" of these names together; 0 where there is none.
std::uint64_t fields(const std::string& path, std::initializer_list<std::string_view> names) {
  std::ifstream in(path);
  std::uint64_t sum = 0;
  for (std::string line; std::getline(in, line);)
    for (const std::string_view name : names)
      if (line.starts_with(name) && line.size() > name.size() && line[name.size()] == ':')
        sum += std::stoull(line.substr(name.size() + 1)) * 1024;
  return sum;
}

}  // namespace

std::vector<pid_t> descendants(const std::string& name) {
  std::map<pid_t, pid_t> parent;
  std::vector<pid_t> named;
  std::error_code ignored;
  for (const auto& entry : std::filesystem::directory_iterator("/proc", ignored)) {
    const std::string digits = entry.path().filename();
    if (!std::all_of(digits.begin(), digits.end(), [](char c) { return c >= '0' && c <= '9'; })) continue;
    const pid_t pid = std::stoi(digits);
    std::ifstream in(proc(pid, "stat"));
    std::string stat;
    std::getline(in, stat);  // pid (name) state parent ...
    const std::size_t open = stat.find('(');
    const std::size_t close = stat.rfind(')');
    if (open == std::string::npos || close == std::string::npos || close + 4 >= stat.size()) continue;
    parent[pid] = std::stoi(stat.substr(close + 4));
    if (stat.substr(open + 1, close - open - 1) == name) named.push_back(pid);
  }
  std::erase_if(named, [&parent](pid_t pid) {
    while (pid > 1 && pid != ::getpid()) pid = parent[pid];
    return pid != ::getpid();
  });
  return named;
}

MemoryWatch::MemoryWatch(std::vector<pid_t> pids) : pids_(std::move(pids)) {
  thread_ = std::thread([this] {
    while (!over_) {
      sample();
      std::this_thread::sleep_for(kBetweenSamples);
    }
  });
}

MemoryWatch::~MemoryWatch() {
  over_ = true;
  thread_.join();
}

std::uint64_t MemoryWatch::sample() {
  std::uint64_t sum = 0;
  for (const pid_t pid : pids_) sum += fields(proc(pid, "smaps_rollup"), {"Pss_Anon", "Pss_Shmem"});
  const std::lock_guard lock(mutex_);
  pss_peak_ = std::max(pss_peak_, sum);
  return sum;
}

Status MemoryWatch::mark() {
  for (const pid_t pid : pids_) {
    std::ofstream out(proc(pid, "clear_refs"));
    out << "5" << std::flush;  // VmHWM becomes VmRSS
    if (!out) return {Code::io_error, fmt::format("{} can't be written", proc(pid, "clear_refs"))};
  }
  const std::lock_guard lock(mutex_);
  pss_peak_ = 0;
  return {};
}

Result<MemoryReading> MemoryWatch::read() {
  MemoryReading reading;
  reading.pss = sample();
  for (const pid_t pid : pids_) {
    const std::uint64_t rss = fields(proc(pid, "status"), {"VmRSS"});
    if (rss == 0) return Status(Code::io_error, fmt::format("process {} of the service is gone", pid));
    reading.rss += rss;
    reading.peak += fields(proc(pid, "status"), {"VmHWM"});
  }
  const std::lock_guard lock(mutex_);
  reading.pss_peak = pss_peak_;
  return reading;
}

}  // namespace rcb::bench
