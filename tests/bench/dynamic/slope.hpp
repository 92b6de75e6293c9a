// rcb_bench slope: what repartitions give to a parallel run of the material point method. slope_mpi, a part a process,
// runs the same slope with cuts that are kept, with bands, and with RCB at tolerances.
//
// Invariants
// 1. All runs compute the same: the bench fails if positions at any step aren't within kSameMetres of those of the
// first
//    run, or if two runs of one setting differ in anything but times.
// 2. The settings take turns, after one untimed run of each. Step 0, the first partition, counts for nothing.
#pragma once

#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "common/base/status.hpp"
#include "tests/bench/json.hpp"

namespace rcb::bench {

inline constexpr double kSameMetres = 1e-6;

struct SlopeBenchOptions {
  std::vector<int> processes{2, 4, 8};
  std::vector<std::string> settings{"rcb:inf", "bands-x:0.1", "rcb:0.1", "rcb:0.02"};  // METHOD:TOLERANCE
  std::string positions = "when-needed";
  int ranks = 2;
  double points = 20'000;
  int steps = 200;
  int repeats = 3;
  std::string json;
};

CLI::App* add_slope(CLI::App& app, SlopeBenchOptions& options);
// `document`: what is told of machine and commit; rows are added. Writes and prints.
Status run_slope(const SlopeBenchOptions& options, Json document);

}  // namespace rcb::bench
