#include "tests/bench/dynamic/dynamic_trajectory.hpp"

#include "client/solvers/scenes.hpp"
#include "client/solvers/step_loop.hpp"
#include "common/base/clock.hpp"
#include "common/io/points.hpp"

namespace rcb::bench {
namespace {

Result<solvers::Simulation> build(const SolverKind& kind, std::uint64_t points) {
  if (std::string(kind.name) == "slope") {
    solvers::SlopeOptions options;
    options.points = points;
    options.interval = kind.interval;
    return solvers::make_slope(options);
  }
  solvers::TwoSpheresOptions options;
  options.points = points;
  options.interval = kind.interval;
  return solvers::make_two_spheres(options);
}

}  // namespace

const std::vector<SolverKind>& solver_kinds() {
  static const std::vector<SolverKind> kinds{
      {"two_spheres", "two balls collide and rebound", 1500, 200, solvers::TwoSpheresOptions{}.interval},
      {"slope", "a submarine slope fails and runs out", 200'000, 40, 1.0}};
  return kinds;
}

const SolverKind* find_solver(const std::string& name) {
  for (const SolverKind& kind : solver_kinds())
    if (name == kind.name) return &kind;
  return nullptr;
}

Result<Trajectory> record(const SolverKind& kind, std::uint64_t points, int steps, const std::string& path,
                          const std::function<bool()>& interrupted) {
  auto simulation = build(kind, points);
  if (!simulation) return simulation.status();
  auto writer = io::TrajectoryWriter::create(path, points, 3);
  if (!writer) return writer.status();
  Trajectory trajectory{kind.name, points, path, {}};
  solvers::StepLoop loop;
  loop.trajectory = writer->get();
  loop.interrupted = interrupted;
  double before = 0;
  loop.after_step = [&](const solvers::RunRecord& record) {
    trajectory.solver_seconds.push_back(record.seconds_physics - before);
    before = record.seconds_physics;
  };
  solvers::RunRecord record;
  if (Status status = run_steps(*simulation, steps, loop, SteadyClock{}, record); !status.ok()) return status;
  if (Status status = (*writer)->close(); !status.ok()) return status;
  trajectory.solver_seconds.front() = 0;  // nothing moves before step 0
  return trajectory;
}

}  // namespace rcb::bench
