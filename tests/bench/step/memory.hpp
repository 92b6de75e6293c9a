// rcb_bench memory: what a service holds beside an empty one, at its peak, while a scene is pushed, moves, is
// repartitioned and is thrown into disorder.
//
// Invariants
// 1. The service is the real one: rcbd under mpirun by the launcher, pushed to by the client's library; each path to it
//    has a service of its own, started anew.
// 2. Peaks are a phase's own. Client and launcher don't count.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "common/base/status.hpp"
#include "tests/bench/json.hpp"

namespace rcb::bench {

struct MemoryOptions {
  std::vector<double> points{1e7};
  std::vector<int> ranks{2};
  std::vector<std::string> paths{"direct", "gateway"};
  int parts = 8;
  std::optional<double> most;  // exit 1 where a peak is more than this many times the particles
  std::string json;
};

CLI::App* add_memory(CLI::App& app, MemoryOptions& options);
// `document`: what is told of machine and commit; rows are added. Writes and prints.
Status run_memory(const MemoryOptions& options, Json document);

}  // namespace rcb::bench
