#include "tests/bench/dynamic/dynamic_replay.hpp"

#include <algorithm>
#include <optional>

#include "common/base/clock.hpp"
#include "common/io/points.hpp"
#include "tests/bench/measure.hpp"

namespace rcb::bench {
namespace {

constexpr const char* kCountWay = "count";

client::Positions positions_of(const io::Points& points) {
  std::array<const double*, 3> axes{};
  for (std::size_t a = 0; a < 3; ++a) axes[a] = points.position[a].data();
  return client::Positions::axes(axes, points.position[0].size());
}

void add(DynamicRun& run, const client::StepReport& report, double waited, double round_trip) {
  run.add({report.seconds_total, report.seconds_search, report.seconds_migrate, report.seconds_exchange, waited,
           round_trip});
  if (report.way != kCountWay) ++run.sent;
  run.repartitions += report.repartitioned ? 1 : 0;
  run.drifted += report.drifted.value_or(0);
  run.moved += report.moved;
  run.migrated += report.migrated;
  run.arrival_mean += report.error_before.value_or(0);
  run.arrival_max = std::max(run.arrival_max, report.error_before.value_or(0));
  run.error_mean += report.error;
  run.error_max = std::max(run.error_max, report.error);
}

constexpr std::array kSums{&DynamicRun::seconds,          &DynamicRun::seconds_search, &DynamicRun::seconds_migrate,
                           &DynamicRun::seconds_exchange, &DynamicRun::seconds_client, &DynamicRun::seconds_round_trip};

}  // namespace

void DynamicRun::add(const StepTimes& times) {
  steps.push_back(times);
  for (std::size_t t = 0; t < times.size(); ++t) this->*kSums[t] += times[t];
}

void DynamicRun::take_medians(std::span<const DynamicRun> runs) {
  for (std::size_t t = 0; t < kSums.size(); ++t) {
    this->*kSums[t] = 0;
    for (std::size_t k = 0; k < steps.size(); ++k) {
      std::vector<double> times;
      for (const DynamicRun& run : runs) times.push_back(run.steps[k][t]);
      this->*kSums[t] += median(std::move(times));
    }
  }
}

Result<DynamicRun> replay(client::Client& client, RoundTrip& round_trip, const Trajectory& trajectory, int parts,
                          const DynamicSetting& setting, const std::function<bool()>& interrupted) {
  client::SceneOptions options;
  options.parts = parts;
  options.tolerance = setting.tolerance;
  options.axis_hysteresis = setting.axis_hysteresis;
  options.policy = setting.cost ? "cost" : "tolerance";
  options.positions = setting.positions;
  options.replace = true;
  if (Status status = client.create_scene("dynamic", options); !status.ok()) return status;
  auto scene = client.open_scene("dynamic");
  if (!scene) return scene.status();
  auto reader = io::open_trajectory(trajectory.path, {});
  if (!reader) return reader.status();
  const SteadyClock clock;
  DynamicRun run;
  double imbalance = 1;
  std::uint64_t message = 16 * static_cast<std::uint64_t>(parts) + 1024;
  std::uint64_t frames = 0;
  for (;; ++frames) {
    if (interrupted()) return Status(Code::aborted, "interrupted");
    auto points = (*reader)->next();
    if (!points) return points.status();
    if (!*points) break;
    const std::uint64_t k = frames;
    const double balanced = trajectory.solver_seconds[k] / parts;
    client::StepOptions step;
    if (k > 0) step.step_seconds = balanced * imbalance;
    const double start = clock.seconds();
    auto result = scene->step(positions_of(**points), step);
    const double waited = clock.seconds() - start;
    if (!result) return result.status();
    if (result->report.way == kCountWay) message = result->report.bytes;
    const auto bare = round_trip.seconds(message, result->report.json.size());
    if (!bare) return Status(Code::internal, "the process of the bare round trip is gone");
    if (k > 0) {
      run.seconds_lost += balanced * (imbalance - 1);
      add(run, result->report, waited, *bare);
    } else {
      run.seconds_first = result->report.seconds_total;
    }
    imbalance = result->report.imbalance;
  }
  if (frames > 1) {
    run.arrival_mean /= static_cast<double>(frames - 1);
    run.error_mean /= static_cast<double>(frames - 1);
  }
  return run;
}

}  // namespace rcb::bench
