// rcb_bench cuts: what a solver asks of the cuts in its own memory, owners and halos, in one thread, beside reading its
// positions once.
#pragma once

#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "common/base/status.hpp"
#include "tests/bench/json.hpp"

namespace rcb::bench {

struct CutsBenchOptions {
  double points = 1e6;
  std::vector<int> parts{8, 64, 1024};
  double width = 0.02;  // of the box's longest side
  int threads = 1;
  int repeats = 15;
  std::string json;
};

CLI::App* add_cuts(CLI::App& app, CutsBenchOptions& options);
// `document`: what is told of machine and commit; rows are added. Writes and prints.
Status run_cuts(const CutsBenchOptions& options, Json document);

}  // namespace rcb::bench
