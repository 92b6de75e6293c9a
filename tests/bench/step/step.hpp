// rcb_bench step: one step of a scene in which every particle moved a little and, but for the variant `send`, nothing
// is repartitioned. Beside it are floors: the positions read once by as many processes as the solver has; where they
// travel, the same bytes through as many bare Unix sockets into the memory of as many processes, and copied there once
// by these processes from memory that they share; where none do, a bare message of the same size and its answer.
//
// Invariants
// 1. Floors, variants and services take turns in one run, over the same positions; each variant has a scene of its own.
// 2. What is timed is what a solver waits for: the call of step() until its report, the floor until every process has
//    said that it has its bytes. Moving the particles is the solver's own.
#pragma once

#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "common/base/status.hpp"
#include "tests/bench/json.hpp"
#include "tests/bench/step/hosts.hpp"
#include "tests/bench/step/step_pusher.hpp"

namespace rcb::bench {

struct StepBenchOptions {
  std::vector<std::string> scenes{"moving", "moving-2d", "moving-shuffled", "moving-small"};
  std::vector<std::string> variants = usual_variants();
  std::vector<int> parts{8};
  std::vector<int> ranks{2, 8};
  // Endpoints of running services, which then take turns in the place of one that is started for each of `ranks`.
  std::vector<std::string> services = {};
  int seats = 4;
  int repeats = 15;
  double points = 0;  // of every scene; 0: its own number
  std::string json;
  HostsOptions links{.hosts = {}};  // of --hosts: `count-members` alone, over links
};

CLI::App* add_step(CLI::App& app, StepBenchOptions& options);
// What `rcb_bench hosts` is to do for --hosts.
HostsOptions over_links(const StepBenchOptions& options);
// `document`: what is told of machine and commit; rows are added. Writes and prints.
Status run_step(const StepBenchOptions& options, Json document);

}  // namespace rcb::bench
