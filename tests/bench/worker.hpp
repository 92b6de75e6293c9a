// The MPI job behind rcb_bench: every rank makes its rows of each scene and lets the contenders run on them.
#pragma once

namespace rcb::bench {

// The word before its arguments: rcb_bench --as-rank PLAN ROWS. Rows go to the file ROWS, one JSON object a line, as
// soon as their cell is measured; progress to standard error. Collective. Returns the exit code.
inline constexpr const char* kWorkerWord = "--as-rank";
int run_worker(int argc, char** argv);

}  // namespace rcb::bench
