// rcb_bench skips: what a step costs with each skip on and off: the two sides of a case do the same step on scenes of
// their own, in turn, in one run.
//
// Invariants
// 1. The service is the real one. What a client can't switch is switched by RCBD_NO_SKIP, in a service beside.
// 2. Sides that partition the same points give the same answers: every report, the parts at the end and the hash are
//    compared, and a difference fails the run.
// 3. Each repeat begins with the other side; what is told is the median of the ratios of the two in one repeat.
#pragma once

#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "common/base/status.hpp"
#include "tests/bench/json.hpp"

namespace rcb::bench {

struct SkipsOptions {
  std::vector<std::string> scenes;  // names of skips; empty: all
  std::vector<int> parts{8};
  std::vector<int> ranks{2};
  int repeats = 15;
  double points = 1'000'000;
  std::string json;
};

CLI::App* add_skips(CLI::App& app, SkipsOptions& options);
// `document`: what is told of machine and commit; rows are added. Writes and prints, also of a run that failed
// half-way.
Status run_skips(const SkipsOptions& options, Json document);

}  // namespace rcb::bench
