// The MPI job behind rcb_stress: one contender answers cell after cell. A peer may end the job or hang in it, so every
// cell is announced before it is begun; the driver sees which one it was, and starts again behind it.
#pragma once

namespace rcb::bench {

// rcb_stress --as-rank PLAN ROWS; the plan has one method. For each cell two rows: {"begun": its number}, then what
// came of it. Collective. Returns the exit code.
int run_stress_worker(int argc, char** argv);

}  // namespace rcb::bench
