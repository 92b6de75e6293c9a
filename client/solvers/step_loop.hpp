// The step loop that the solvers share: push the positions, advance, push again; with a check of conservation.
//
// 1. Step 0 is the initial state; `steps` more follow, so there are steps + 1 frames and reports.
// 2. A failed push ends the run: no step is silently left out.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

#include "client/lib/client.hpp"
#include "client/solvers/mpm/mpm.hpp"
#include "client/solvers/scenes.hpp"
#include "common/base/clock.hpp"
#include "common/base/status.hpp"
#include "common/io/points.hpp"

namespace rcb::solvers {

// How well a run conserves momentum and energy.
struct PhysicsCheck {
  Balance start;
  Balance end;
  Vec3 impulse{};             // from gravity and the boundaries
  double momentum_drift = 0;  // largest |momentum - start - impulse|, relative to the sum of mass times speed
  double energy_largest = 0;  // J; kinetic + elastic + potential
  double energy_growth = 0;   // largest rise above the start, relative to the largest kinetic + elastic energy
};

struct RunRecord {
  std::int64_t steps_done = -1;  // the last completed step; -1: none
  std::vector<client::StepReport> reports;
  PhysicsCheck physics;
  struct RunOut {
    double length = 0;  // m, initial length of the body
    double start = 0;   // m, x of the front
    double end = 0;
  };
  std::optional<RunOut> runout;  // only for a scene with a run-out
  std::uint64_t substeps = 0;
  double seconds_physics = 0;
  double seconds_service = 0;  // waiting for pushes, measured here

  std::uint64_t repartitions() const;  // including the first partition
  struct Largest {
    double error;
    std::int64_t step;
  };
  // The largest error in all reports, before and after each step's repartition; nothing without reports.
  std::optional<Largest> largest_error() const;
};

struct StepLoop {
  // Pushes the positions as step `step`; seconds: computing time of this step, none at step 0. Empty: nothing is
  // pushed.
  using Push = std::function<Result<client::StepReport>(std::int64_t step, const client::Positions& positions,
                                                        std::optional<double> seconds)>;
  Push push;
  io::TrajectoryWriter* trajectory = nullptr;  // may be null; not closed here
  std::function<void(const RunRecord&)> after_step;
  std::function<bool()> interrupted;
};

// Runs the simulation for `steps` steps. On failure, too, `record` is filled in as far as the run came. Errors: aborted
// if interrupted; those of push, trajectory and physics.
Status run_steps(Simulation& simulation, std::int64_t steps, const StepLoop& loop, const Clock& clock,
                 RunRecord& record);

}  // namespace rcb::solvers
