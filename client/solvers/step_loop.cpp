#include "client/solvers/step_loop.hpp"

#include <algorithm>
#include <array>

#include <fmt/format.h>

namespace rcb::solvers {
namespace {

Status append_frame(io::TrajectoryWriter& trajectory, const Mpm& mpm, std::vector<double>& frame) {
  frame.resize(mpm.size() * 3);
  for (std::size_t p = 0; p < mpm.size(); ++p)
    for (std::size_t a = 0; a < 3; ++a) frame[p * 3 + a] = mpm.position(a)[p];
  return trajectory.append(frame);
}

Result<client::StepReport> push_step(const StepLoop& loop, std::int64_t step, const Mpm& mpm,
                                     std::optional<double> seconds) {
  const std::array<const double*, 3> axes{mpm.position(0).data(), mpm.position(1).data(), mpm.position(2).data()};
  return loop.push(step, client::Positions::axes(axes, mpm.size()), seconds);
}

class Checker {
 public:
  explicit Checker(const Mpm& mpm) : impulse_start_(mpm.impulse()) {}

  void look(const Mpm& mpm, PhysicsCheck& check) {
    const Balance now = mpm.balance();
    if (first_) {
      check.start = now;
      check.energy_largest = now.energy();
      first_ = false;
    }
    check.end = now;
    check.impulse = mpm.impulse() - impulse_start_;
    speed_sum_max_ = std::max(speed_sum_max_, now.speed_sum);
    activity_max_ = std::max(activity_max_, now.kinetic + now.elastic);
    check.energy_largest = std::max(check.energy_largest, now.energy());
    if (speed_sum_max_ > 0)
      check.momentum_drift =
          std::max(check.momentum_drift, norm(now.momentum - check.start.momentum - check.impulse) / speed_sum_max_);
    if (activity_max_ > 0) check.energy_growth = (check.energy_largest - check.start.energy()) / activity_max_;
  }

 private:
  Vec3 impulse_start_;
  double speed_sum_max_ = 0;
  double activity_max_ = 0;
  bool first_ = true;
};

}  // namespace

std::uint64_t RunRecord::repartitions() const {
  return static_cast<std::uint64_t>(
      std::count_if(reports.begin(), reports.end(), [](const auto& report) { return report.repartitioned; }));
}

std::optional<RunRecord::Largest> RunRecord::largest_error() const {
  std::optional<Largest> largest;
  for (const client::StepReport& report : reports) {
    const double error = std::max(report.error, report.error_before.value_or(0));
    if (!largest || error > largest->error) largest = Largest{error, report.step};
  }
  return largest;
}

Status run_steps(Simulation& simulation, std::int64_t steps, const StepLoop& loop, const Clock& clock,
                 RunRecord& record) {
  Mpm& mpm = simulation.mpm;
  Checker checker(mpm);
  std::vector<double> frame;
  for (std::int64_t step = 0; step <= steps; ++step) {
    if (loop.interrupted && loop.interrupted())
      return {Code::aborted,
              fmt::format("interrupted; {} of {} steps were carried out", record.steps_done + 1, steps + 1),
              "start the run again"};
    const double start = clock.seconds();
    if (step > 0)
      if (Status status = mpm.advance(simulation.interval); !status.ok()) return status;
    const double advanced = clock.seconds() - start;
    checker.look(mpm, record.physics);
    if (simulation.length > 0) {
      const double reached = front(mpm);
      if (!record.runout) record.runout = RunRecord::RunOut{simulation.length, reached, reached};
      record.runout->end = reached;
    }
    record.substeps = mpm.substeps();
    record.seconds_physics += clock.seconds() - start;

    if (loop.trajectory != nullptr)
      if (Status status = append_frame(*loop.trajectory, mpm, frame); !status.ok()) return status;
    if (loop.push) {
      const double begin = clock.seconds();
      auto report = push_step(loop, step, mpm, step > 0 ? std::optional(advanced) : std::nullopt);
      record.seconds_service += clock.seconds() - begin;
      if (!report)
        return {report.status().code(), fmt::format("step {}: {}", step, report.status().message()),
                report.status().hint()};
      record.reports.push_back(std::move(*report));
    }
    record.steps_done = step;
    if (loop.after_step) loop.after_step(record);
  }
  return {};
}

}  // namespace rcb::solvers
