// What a run of slope_mpi was asked for, and what is told at its end.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "client/solvers/drive.hpp"
#include "client/solvers/mpi/cores.hpp"
#include "client/solvers/scenes.hpp"
#include "client/solvers/step_loop.hpp"

namespace rcb::solvers {

// The command line.
struct MpiOptions : RunOptions {
  SlopeOptions slope;
  std::string method = "rcb";
  bool check = false;
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
