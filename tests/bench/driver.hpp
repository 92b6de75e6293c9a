// The driver: one MPI job a rank count, one after the other, and what they measured put together.
#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "common/base/status.hpp"
#include "tests/bench/plan.hpp"

namespace rcb::bench {

struct Rows {
  nlohmann::ordered_json rows = nlohmann::ordered_json::array();
  Status status;  // not ok: a job failed; `rows` has what was measured before
};

// Runs `plan` on each number of ranks through mpirun. Waits for a job as long as it goes on measuring; one that
// measures nothing for kStallSeconds is killed. Errors: deadline_exceeded, aborted (SIGINT or SIGTERM), internal,
// io_error.
inline constexpr double kStallSeconds = 1800;
Rows run_jobs(const Plan& plan, const std::vector<int>& ranks);

// CPU, cores, memory, system, MPI, compiler, load before the start.
nlohmann::ordered_json describe_machine();
// The peers that this build has, in words.
std::string describe_peers();

}  // namespace rcb::bench
