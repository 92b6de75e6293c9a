// rcb_bench drift: what new cuts cost after a drift. The particles lie with the owners of their parts, a smooth flow
// moves them until a given share of them has crossed a cut; then they are repartitioned from the cuts in force, and by
// a search among all, in turn.
//
// Invariants
// 1. Every turn begins with the same particles, parts and cuts; both give the same tree, or the run fails.
#pragma once

#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "common/base/status.hpp"
#include "tests/bench/json.hpp"

namespace rcb::bench {

struct DriftOptions {
  std::vector<std::string> scenes{"slope", "uniform", "clusters", "two-spheres", "plane"};
  std::vector<int> parts{8, 64};
  std::vector<int> ranks{2, 8};
  std::vector<double> crossed{0.01};
  int repeats = 7;
  std::string json;
};

CLI::App* add_drift(CLI::App& app, DriftOptions& options);

// `document`: what is told of machine and commit; rows are added. Writes and prints, also of a run that failed
// half-way.
Status run_drift(const DriftOptions& options, Json document);

// The word before a rank's arguments: rcb_bench --drift-as-rank PLAN ROWS. Returns the exit code.
inline constexpr const char* kDriftWord = "--drift-as-rank";
int run_drift_worker(int argc, char** argv);

}  // namespace rcb::bench
