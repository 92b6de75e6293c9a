#include "tests/bench/step/hosts.hpp"

#include <cerrno>
#include <cstring>
#include <filesystem>

#include <fmt/format.h>
#include <unistd.h>

#include "tests/bench/options.hpp"

namespace rcb::bench {
namespace {

constexpr int kHostsMax = 16;

Status check(const HostsOptions& options) {
  OptionCheck check("rcb_bench hosts");
  check.between("--hosts", options.hosts, 2, kHostsMax);
  check.between("--latency", options.latency, 0, 1000);
  for (const double rate : options.bandwidth)
    check.holds(rate > 0 && rate <= 1000, fmt::format("--bandwidth {}: give up to 1000 Gbit/s", rate));
  check.whole("--points", {options.points}, 1000, 1e8);
  check.between("--repeats", std::vector{options.repeats}, 1, kRepeatsMax);
  check.holds(geteuid() == 0, "machines are made of network namespaces, which only root may");
  return check.status();
}

template <typename T>
std::string list_of(const std::vector<T>& values) {
  return fmt::format("{}", fmt::join(values, ","));
}

}  // namespace

CLI::App* add_hosts(CLI::App& app, HostsOptions& options) {
  auto* command = app.add_subcommand("hosts",
                                     "steps and partitions over links with latency and bandwidth, beside the "
                                     "model of docs/scale.md (as root)");
  add_list(*command, "--hosts", options.hosts, "numbers of machines, a rank on each");
  add_list(*command, "--latency", options.latency,
           "round trips between machines, in milliseconds; l in docs/scale.md is half of one");
  add_list(*command, "--bandwidth", options.bandwidth, "of a link, in Gbit/s");
  command->add_option("--points", options.points, "particles, uniform in a cube")->capture_default_str();
  command->add_option("--repeats", options.repeats, "timed steps of each kind")->capture_default_str();
  command->add_flag("--keep-windows", options.keep_windows, "TCP does not begin anew after a pause");
  command->add_option("--json", options.json, "write the result to this file");
  return command;
}

Status run_hosts(const HostsOptions& options, const Json& document) {
  if (Status status = check(options); !status.ok()) return status;
  std::error_code ignored;
  const auto build = std::filesystem::read_symlink("/proc/self/exe", ignored).parent_path().parent_path();
  std::vector<std::string> words{"python3",    RCB_BENCH_SOURCE "/step/links.py",
                                 "--build",    build.string(),
                                 "--hosts",    list_of(options.hosts),
                                 "--points",   fmt::format("{:.0f}", options.points),
                                 "--repeats",  std::to_string(options.repeats),
                                 "--document", document.dump()};
  if (!options.latency.empty()) words.insert(words.end(), {"--latency", list_of(options.latency)});
  if (!options.bandwidth.empty()) words.insert(words.end(), {"--bandwidth", list_of(options.bandwidth)});
  if (options.keep_windows) words.emplace_back("--keep-windows");
  if (options.counts_alone) words.emplace_back("--counts-alone");
  if (!options.json.empty()) words.insert(words.end(), {"--json", options.json});
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  execv("/usr/bin/python3", argv.data());
  return {Code::io_error, fmt::format("/usr/bin/python3 can't be started: {}", std::strerror(errno))};
}

}  // namespace rcb::bench
