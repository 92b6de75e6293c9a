// rcb_bench dynamic: what a tolerance costs and what it buys. The solver runs once and leaves a trajectory; a service
// is then driven along it once for every tolerance, so that only the service is timed and all of them see the same
// motion.
//
// Invariants
// 1. The service is the real one: rcbd under mpirun by the launcher, pushed to by the client's library.
// 2. The first push, which is partitioned whatever the tolerance, counts in nothing but `seconds_first`.
// 3. A peer of the same number of ranks, without a service, follows the same trajectory (dynamic_peers.hpp).
// 4. Settings and peer take turns, and each repeat begins with another one. A row's times are sums of each step's
// median
//    over the repeats; with the policy cost, of the repeat with the median time.
#pragma once

#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "common/base/status.hpp"
#include "tests/bench/json.hpp"

namespace rcb::bench {

struct DynamicOptions {
  std::vector<std::string> scenes{"two_spheres", "slope"};
  std::vector<double> tolerances;  // infinity among them
  std::vector<int> parts{8};
  std::vector<int> ranks{2};
  std::vector<std::string> positions{"when-needed", "every-step"};
  std::vector<double> hystereses{1.2};
  int repeats = 3;
  bool peers = true;
  double points = 0;  // of every scene; 0: its own number
  int steps = 0;      // likewise
  std::string json;
  std::string figure;
};

CLI::App* add_dynamic(CLI::App& app, DynamicOptions& options);

// `document`: what is told of machine and commit; rows are added. Writes and prints, also of a run that failed
// half-way.
Status run_dynamic(const DynamicOptions& options, Json document);

}  // namespace rcb::bench
