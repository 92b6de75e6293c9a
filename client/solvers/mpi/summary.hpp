// What a run of slope_mpi was asked for, and what is told at its end.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "client/solvers/mpi/cores.hpp"
#include "client/solvers/scenes.hpp"
#include "client/solvers/step_loop.hpp"

namespace rcb::solvers {

// The command line.
struct MpiOptions {
  SlopeOptions slope;
  std::int64_t steps = 200;
  int parts = 8;
  std::string method = "rcb";
  double tolerance = 0.1;
  std::string positions = "when-needed";
  std::string scene = "slope";
  std::string endpoint;
  std::string trajectory;
  double deadline_seconds = 60;
  bool outlive = true;
  bool check = false;
  bool json = false;
};

struct MpiRecord : RunRecord {
  std::vector<std::uint64_t> held;  // points by process, after the last step
  std::vector<Work> work;           // of this process, by step
  std::vector<Work> sum, largest;   // of all processes
};

// For people, and as one JSON document.
std::string summary(const MpiOptions& options, int processes, const MpiRecord& record);
std::string json_document(const MpiOptions& options, int processes, const MpiRecord& record);

}  // namespace rcb::solvers
