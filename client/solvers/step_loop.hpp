// The step loop that the solvers share: push what stands, move on, push again; and the physics check beside it.
//
// 1. Step 0 is the start; `steps` more follow, so there are steps + 1 frames and reports.
// 2. A push that fails ends the run: no step is left out in silence.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

#include "client/lib/client.hpp"
#include "client/solvers/mpm.hpp"
#include "client/solvers/scenes.hpp"
#include "common/base/clock.hpp"
#include "common/base/status.hpp"
#include "common/io/points.hpp"

namespace rcb::solvers {

// What conservation says about a run.
struct PhysicsCheck {
  Balance start;
  Balance end;
  Vec3 impulse{};             // given by gravity and the boundaries
  double momentum_drift = 0;  // largest |momentum - start - impulse|, as a share of the sum of mass times speed
  double energy_largest = 0;  // J; kinetic + elastic + potential
  double energy_growth = 0;   // largest rise above the start, as a share of kinetic + elastic at its largest
};

struct RunRecord {
  std::int64_t steps_done = -1;  // the last step that was carried out; -1: none
  std::vector<client::StepReport> reports;
  PhysicsCheck physics;
  struct RunOut {
    double length = 0;  // m, of the body at the start
    double start = 0;   // m, the front's place on x
    double end = 0;
  };
  std::optional<RunOut> runout;  // of a scene that runs out
  std::uint64_t substeps = 0;
  double seconds_physics = 0;
  double seconds_service = 0;  // waiting for pushes, as this side saw it

  std::uint64_t repartitions() const;  // the first partition included
  std::uint64_t recreations() const;   // of the scene, after losses of the service
  struct Largest {
    double error;
    std::int64_t step;
  };
  // Over all reports, before and after each step's repartition; none without reports.
  std::optional<Largest> largest_error() const;
};

struct StepLoop {
  // Pushes the positions as step `step`; seconds: what the physics of this step took, none at step 0. Empty: nobody to
  // push to.
  using Push = std::function<Result<client::StepReport>(std::int64_t step, const client::Positions& positions,
                                                        std::optional<double> seconds)>;
  Push push;
  io::TrajectoryWriter* trajectory = nullptr;  // or none; left open
  std::function<void(const RunRecord&)> after_step;
  std::function<bool()> interrupted;
};

// Runs the simulation through `steps` steps. `record` is filled as far as it came, also when this fails.
// Errors: kAborted when interrupted; what push, trajectory and physics say.
Status run_steps(Simulation& simulation, std::int64_t steps, const StepLoop& loop, const Clock& clock,
                 RunRecord& record);

}  // namespace rcb::solvers
