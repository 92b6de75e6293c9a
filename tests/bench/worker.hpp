// The MPI job behind rcb_bench: every rank makes its rows of each scene and lets the contenders run on them.
#pragma once

#include <functional>
#include <string>

#include "common/base/status.hpp"
#include "common/comm/comm.hpp"
#include "tests/bench/plan.hpp"

namespace rcb::bench {

// One rank of a benchmark's MPI job, from MPI's start to its end: PROGRAM --as-rank PLAN ROWS. Collective. Returns the
// exit code.
using RankBody = std::function<Status(comm::Comm&, const std::string& plan_path, const std::string& rows_path)>;
int run_as_rank(int argc, char** argv, const char* program, const RankBody& body);
// The body of a job whose plan is a Plan.
RankBody with_plan(std::function<Status(comm::Comm&, const Plan&, const std::string& rows_path)> body);

// The word before its arguments: rcb_bench --as-rank PLAN ROWS. Rows go to the file ROWS, one JSON object a line, as
// soon as their cell is measured, and {"begun": a skip} before every run; progress to standard error. Collective.
// Returns the exit code.
inline constexpr const char* kWorkerWord = "--as-rank";
int run_worker(int argc, char** argv);

}  // namespace rcb::bench
