// rcb_bench hosts: rounds, bytes and time of steps and partitions of a service over several machines, whose links have
// a delay and a bandwidth, beside what the model of docs/scale.md says. links.py makes the machines and measures.
#pragma once

#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "common/base/status.hpp"
#include "tests/bench/json.hpp"

namespace rcb::bench {

struct HostsOptions {
  std::vector<int> hosts{2, 3, 5};
  std::vector<double> latency;    // round trips, in milliseconds; with bandwidth empty: the settings of docs/scale.md
  std::vector<double> bandwidth;  // Gbit/s
  double points = 100000;
  int repeats = 15;
  bool keep_windows = false;
  bool counts_alone = false;  // rcb_bench step --hosts: no step that sends, and no partition
  std::string json;
};

CLI::App* add_hosts(CLI::App& app, HostsOptions& options);
// Goes on as links.py, so it returns only if that can't be started. document: what is told of machine and commit.
Status run_hosts(const HostsOptions& options, const Json& document);

}  // namespace rcb::bench
