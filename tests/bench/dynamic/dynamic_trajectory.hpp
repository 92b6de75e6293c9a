// A trajectory: the positions of every step of a solver's run, in a file, and how long the solver took for each.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "common/base/status.hpp"

namespace rcb::bench {

struct Trajectory {
  std::string scene;
  std::uint64_t points = 0;
  std::string path;                    // .npy: (steps + 1, points, 3)
  std::vector<double> solver_seconds;  // by step; 0 for step 0
};

struct SolverKind {
  const char* name;
  const char* what;
  std::uint64_t points;
  int steps;
  double interval;  // s, a step
};
const std::vector<SolverKind>& solver_kinds();
const SolverKind* find_solver(const std::string& name);  // null: none of that name

// Errors: the solver's own; io_error; aborted where `interrupted` says so.
Result<Trajectory> record(const SolverKind& kind, std::uint64_t points, int steps, const std::string& path,
                          const std::function<bool()>& interrupted);

}  // namespace rcb::bench
