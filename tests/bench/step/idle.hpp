// rcb_bench idle: what a service costs while its client says nothing, what its ranks but 0 cost while the client steps
// by counts, and how soon it answers queries.
//
// Invariants
// 1. The service is the real one: rcbd under mpirun by the launcher. A client of the library is connected and holds a
//    scene with particles open.
// 2. CPU time is that of all threads of all ranks and of mpirun, by the scheduler's own count in nanoseconds.
#pragma once

#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "common/base/status.hpp"
#include "tests/bench/json.hpp"

namespace rcb::bench {

struct IdleOptions {
  std::vector<int> ranks{8};
  double seconds = 30;
  int queries = 200;  // of each kind
  int counts = 10000;
  double points = 100000;
  std::string json;
};

CLI::App* add_idle(CLI::App& app, IdleOptions& options);
// `document`: what is told of machine and commit; rows are added. Writes and prints.
Status run_idle(const IdleOptions& options, Json document);

}  // namespace rcb::bench
