// A peer along the same trajectory as the service: Zoltan RCB with KEEP_CUTS=1 and RCB_REUSE=1, as a parallel solver
// would call it. Its ranks hold the particles and have a step's positions already.
//
// Invariants
// 1. Like ours, each particle stands after each step on the rank that owns its position: what left its part's box
//    (Zoltan_RCB_Box) is asked of Zoltan_LB_Point_PP_Assign and handed over by Zoltan_Migrate. New cuts are searched
//    when the error reaches the tolerance and is above that of the quotas, and are followed by their export lists.
// 2. Timed is from barrier to barrier all that this takes; reading positions isn't. Parts of the time are rank 0's.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/comm/comm.hpp"
#include "common/io/points.hpp"
#include "tests/bench/dynamic/dynamic_replay.hpp"
#include "tests/bench/dynamic/dynamic_trajectory.hpp"
#include "tests/bench/json.hpp"

namespace rcb::bench {

// What one job is to do.
struct PeerPlan {
  Trajectory trajectory;
  std::vector<int> parts;
  std::vector<double> tolerances;
  int repeat = 0;  // which one this is: it begins with the tolerance of this number
};
Status save(const PeerPlan& plan, const std::string& path);
Result<PeerPlan> load_peer_plan(const std::string& path);

struct PeerRun {
  int parts = 1;
  double tolerance = 0;
  DynamicRun run;
};
Json json_of(const PeerRun& run);
// Throws nlohmann::json::exception.
PeerRun peer_run_of(const Json& json);

// The word before a rank's arguments: rcb_bench --as-rank-along PLAN ROWS; a run a line.
inline constexpr const char* kPeerWord = "--as-rank-along";
int run_peer_worker(int argc, char** argv);

bool has_dynamic_peer();
// One run along all frames. Collective; the result is rank 0's.
Result<DynamicRun> drive_zoltan(comm::Comm& comm, io::TrajectoryReader& reader, const Trajectory& trajectory, int parts,
                                double tolerance);

}  // namespace rcb::bench
