#include "tests/bench/dynamic/dynamic.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include <fmt/format.h>

#include "client/launch/launch.hpp"
#include "client/launch/reach.hpp"
#include "tests/bench/driver.hpp"
#include "tests/bench/dynamic/dynamic_peers.hpp"
#include "tests/bench/dynamic/dynamic_replay.hpp"
#include "tests/bench/dynamic/dynamic_report.hpp"
#include "tests/bench/dynamic/dynamic_trajectory.hpp"
#include "tests/bench/json.hpp"
#include "tests/bench/options.hpp"
#include "tests/bench/report.hpp"

namespace rcb::bench {
namespace {

constexpr int kStepsMax = 1'000'000;

Status check(const DynamicOptions& options) {
  OptionCheck check("rcb_bench dynamic");
  check.between("--parts", options.parts, 1, kPartsMax);
  check.between("--ranks", options.ranks, 1, kRanksMax);
  check.between("--tolerances", options.tolerances, 0, std::numeric_limits<double>::infinity());
  for (const double hysteresis : options.hystereses)
    check.holds(hysteresis >= 1 && !std::isinf(hysteresis),
                fmt::format("--axis-hysteresis {}: give finite numbers >= 1", hysteresis));
  check.between("--repeats", std::vector{options.repeats}, 1, kRepeatsMax);
  check.whole("--points", {options.points}, 0, 1e9);
  check.between("--steps", std::vector{options.steps}, 0, kStepsMax);
  check.known("--positions", options.positions,
              [](const std::string& word) { return word == "when-needed" || word == "every-step"; });
  check.known("--scenes", options.scenes, [](const std::string& scene) { return find_solver(scene) != nullptr; });
  return check.status();
}

// peer: Zoltan, which of a setting has the tolerance alone.
Json row_of(const Trajectory& trajectory, int parts, int ranks, const DynamicSetting& setting, bool peer,
            std::vector<DynamicRun> runs) {
  std::sort(runs.begin(), runs.end(), [](const auto& a, const auto& b) { return a.seconds_client < b.seconds_client; });
  DynamicRun run = runs[(runs.size() - 1) / 2];
  const auto [least, most] =
      std::minmax_element(runs.begin(), runs.end(), [](const auto& a, const auto& b) { return a.seconds < b.seconds; });
  if (!setting.cost) run.take_medians(runs);  // the policy cost need not repartition at the same steps
  Json tolerance;
  if (!setting.cost) tolerance = std::isinf(setting.tolerance) ? Json("inf") : Json(setting.tolerance);
  return {{"scene", trajectory.scene},
          {"n", trajectory.points},
          {"dims", 3},
          {"parts", parts},
          {"ranks", ranks},
          {"tool", peer ? "Zoltan" : "rcbd"},
          {"method", peer ? "RCB" : "rcb"},
          {"work", "dynamic"},
          {"cut_tolerance", 0},
          {"policy", setting.cost ? "cost" : "tolerance"},
          {"tolerance", tolerance},
          {"positions", peer ? Json() : Json(setting.positions)},
          {"axis_hysteresis", peer ? Json() : Json(setting.axis_hysteresis)},
          {"steps", trajectory.solver_seconds.size() - 1},
          {"seconds", run.seconds},
          {"seconds_min", least->seconds},
          {"seconds_max", most->seconds},
          {"seconds_client", run.seconds_client},
          {"seconds_balancing", run.seconds_search + run.seconds_migrate},
          {"seconds_search", run.seconds_search},
          {"seconds_migrate", run.seconds_migrate},
          {"seconds_exchange", run.seconds_exchange},
          {"seconds_round_trip", peer ? Json() : Json(run.seconds_round_trip)},
          {"seconds_first", run.seconds_first},
          {"seconds_lost", run.seconds_lost},
          {"seconds_both", run.seconds_client + run.seconds_lost},
          {"repartitions", run.repartitions},
          {"sent", peer ? Json() : Json(run.sent)},
          {"drifted", run.drifted},
          {"moved", run.moved},
          {"migrated", run.migrated},
          {"error", run.error_mean},
          {"error_max", run.error_max},
          {"error_before_mean", run.arrival_mean},
          {"error_before_max", run.arrival_max},
          {"ratio", Json::object()}};
}

std::vector<DynamicSetting> settings_of(const DynamicOptions& options) {
  std::vector<DynamicSetting> settings;
  for (const std::string& positions : options.positions)
    for (const double hysteresis : options.hystereses) {
      for (const double tolerance : options.tolerances) settings.push_back({positions, false, tolerance, hysteresis});
      settings.push_back({positions, true, std::numeric_limits<double>::infinity(), hysteresis});
    }
  return settings;
}

// The runs of one tool along a trajectory: by number of parts, then by setting.
using Runs = std::vector<std::vector<std::vector<DynamicRun>>>;

// All settings once, at a service that runs.
Status replay_all(const DynamicOptions& options, client::Client& client, RoundTrip& round_trip,
                  const Trajectory& trajectory, int repeat, Runs& runs) {
  const auto settings = settings_of(options);
  for (std::size_t p = 0; p < options.parts.size(); ++p)
    for (std::size_t k = 0; k < settings.size(); ++k) {
      const std::size_t s = (k + static_cast<std::size_t>(repeat)) % settings.size();
      auto run = replay(client, round_trip, trajectory, options.parts[p], settings[s], interrupted);
      if (!run) return run.status();
      runs[p][s].push_back(*run);
    }
  return {};
}

// All tolerances once, by Zoltan in an MPI job of its own.
Status replay_peer(const DynamicOptions& options, const Trajectory& trajectory, int ranks, const std::string& folder,
                   int repeat, Runs& runs) {
  const PeerPlan plan{trajectory, options.parts, options.tolerances, repeat};
  if (Status status = save(plan, folder + "/plan"); !status.ok()) return status;
  Json lines = Json::array();
  if (Status status = run_job(folder, kPeerWord, ranks, kStallSeconds, lines); !status.ok()) return status;
  try {
    for (const Json& line : lines) {
      const PeerRun run = peer_run_of(line);
      const auto p = std::find(options.parts.begin(), options.parts.end(), run.parts) - options.parts.begin();
      const auto t = std::find(options.tolerances.begin(), options.tolerances.end(), run.tolerance);
      runs.at(static_cast<std::size_t>(p))
          .at(static_cast<std::size_t>(t - options.tolerances.begin()))
          .push_back(run.run);
    }
  } catch (const nlohmann::json::exception& error) {
    return {Code::internal, fmt::format("a run of Zoltan: {}", error.what())};
  }
  return {};
}

// Along one trajectory: all settings in a service of its own and, in turn with it, Zoltan.
Status measure_ranks(const DynamicOptions& options, const Trajectory& trajectory, int ranks, const std::string& folder,
                     Json& rows) {
  const bool peers = options.peers && has_dynamic_peer();
  const auto settings = settings_of(options);
  Runs ours(options.parts.size(), std::vector<std::vector<DynamicRun>>(settings.size()));
  Runs theirs(options.parts.size(), std::vector<std::vector<DynamicRun>>(options.tolerances.size()));
  RoundTrip round_trip;
  auto service = launch::Embedded::start(ranks, [](double) {});
  if (!service) return service.status();
  auto client = launch::reach(service->endpoint(), "rcb_bench");
  if (!client) return service->explain(client.status());
  for (int repeat = 0; repeat < options.repeats; ++repeat) {
    fmt::print(stderr, "ranks {}: {}, {} points, repeat {}\n", ranks, trajectory.scene, trajectory.points, repeat + 1);
    Status status = replay_all(options, *client, round_trip, trajectory, repeat, ours);
    if (!status.ok()) return service->explain(status);
    if (peers) status = replay_peer(options, trajectory, ranks, folder, repeat, theirs);
    if (!status.ok()) return status;
  }
  for (std::size_t p = 0; p < options.parts.size(); ++p)
    for (std::size_t s = 0; s < settings.size(); ++s)
      rows.push_back(row_of(trajectory, options.parts[p], ranks, settings[s], false, ours[p][s]));
  for (std::size_t p = 0; p < options.parts.size(); ++p)
    for (std::size_t t = 0; t < options.tolerances.size() && peers; ++t)
      rows.push_back(
          row_of(trajectory, options.parts[p], ranks, {.tolerance = options.tolerances[t]}, true, theirs[p][t]));
  return {};
}

Status measure_all(const DynamicOptions& options, Json& rows) {
  const TemporaryFolder folder;
  if (folder.path().empty()) return {Code::io_error, "no temporary folder can be made", "see TMPDIR"};
  prepare_jobs();
  for (const std::string& scene : options.scenes) {
    const SolverKind& kind = *find_solver(scene);
    const auto points = options.points > 0 ? static_cast<std::uint64_t>(options.points) : kind.points;
    const int steps = options.steps > 0 ? options.steps : kind.steps;
    fmt::print(stderr, "{}: {} points, {} steps are computed\n", scene, points, steps);
    const auto trajectory = record(kind, points, steps, folder.path() + "/" + scene + ".npy", interrupted);
    if (!trajectory) return trajectory.status();
    for (const int ranks : options.ranks)
      if (Status status = measure_ranks(options, *trajectory, ranks, folder.path(), rows); !status.ok()) return status;
    std::remove(trajectory->path.c_str());
  }
  return {};
}

}  // namespace

CLI::App* add_dynamic(CLI::App& app, DynamicOptions& options) {
  options.tolerances = {0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, std::numeric_limits<double>::infinity()};
  auto* command =
      app.add_subcommand("dynamic", "what a solver waits, and the error, along its run, for every tolerance");
  add_list(*command, "--scenes", options.scenes, "two_spheres, slope");
  add_list(*command, "--tolerances", options.tolerances, "tolerances; the policy cost is run beside them");
  add_list(*command, "--parts", options.parts, "numbers of parts");
  add_list(*command, "--ranks", options.ranks, "numbers of MPI ranks, one service each");
  add_list(*command, "--positions", options.positions, "of our scenes: when-needed, every-step");
  add_list(*command, "--axis-hysteresis", options.hystereses, "of our scenes");
  command->add_flag("!--no-peers", options.peers, "leave Zoltan out");
  command->add_option("--repeats", options.repeats, "timed runs of each setting")->capture_default_str();
  command->add_option("--points", options.points, "points of every scene, instead of its own number");
  command->add_option("--steps", options.steps, "steps of every scene, instead of its own number");
  command->add_option("--json", options.json, "write the result to this file");
  command->add_option("--figure", options.figure,
                      "draw what a solver waits against error as SVG (gnuplot source beside it)");
  return command;
}

Status run_dynamic(const DynamicOptions& options, Json document) {
  if (Status status = check(options); !status.ok()) return status;
  document["rows"] = Json::array();
  const Status measured = measure_all(options, document["rows"]);
  print(dynamic_tables(document));
  if (Status status = write_result(options.json, document); !status.ok()) return status;
  if (!measured.ok() || options.figure.empty()) return measured;
  return draw_dynamic(document, options.figure);
}

}  // namespace rcb::bench
