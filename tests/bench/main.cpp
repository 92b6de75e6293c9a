// rcb_bench: times the engine beside its peers. Also the MPI program that it starts for that (worker.hpp).
#include <cmath>
#include <cstdio>
#include <functional>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "rcb_bench_commit.hpp"
#include "tests/bench/cuts.hpp"
#include "tests/bench/driver.hpp"
#include "tests/bench/dynamic/dynamic.hpp"
#include "tests/bench/dynamic/dynamic_peers.hpp"
#include "tests/bench/dynamic/slope.hpp"
#include "tests/bench/figure.hpp"
#include "tests/bench/json.hpp"
#include "tests/bench/options.hpp"
#include "tests/bench/report.hpp"
#include "tests/bench/scenes.hpp"
#include "tests/bench/step/drift.hpp"
#include "tests/bench/step/hosts.hpp"
#include "tests/bench/step/idle.hpp"
#include "tests/bench/step/memory.hpp"
#include "tests/bench/step/skips.hpp"
#include "tests/bench/step/step.hpp"
#include "tests/bench/worker.hpp"

namespace rcb::bench {
namespace {

constexpr double kPointsMax = 2e9;  // a rank's count is an int for the peers

const std::vector<std::string> kMethods{"rcb", "bands-x", "bands-y", "bands-z", "read", "RCB", "RIB", "HSFC", "MJ"};

struct Options {
  std::vector<int> parts;
  std::vector<int> ranks{1, 2, 4, 8};
  std::vector<std::string> scenes;
  std::vector<std::string> methods;
  std::vector<double> cut_tolerances{0, 0.01, 0.1};
  std::vector<double> points;
  int repeats = 5;
  std::string json;
  std::string figure;
};

Status check(Options& options) {
  OptionCheck check("rcb_bench");
  check.between("--parts", options.parts, 1, kPartsMax);
  check.between("--ranks", options.ranks, 1, kRanksMax);
  check.between("--repeats", std::vector{options.repeats}, 1, kRepeatsMax);
  check.whole("--points", options.points, 1, kPointsMax);
  check.between("--cut-tolerances", options.cut_tolerances, 0, 1);
  check.known("--scenes", options.scenes, [](const std::string& scene) { return find_scene_kind(scene) != nullptr; });
  check.known("--methods", options.methods, [](const std::string& method) {
    return std::find(kMethods.begin(), kMethods.end(), method) != kMethods.end();
  });
  if (!check.status().ok()) return check.status();
  // The exact run is never left out.
  std::sort(options.cut_tolerances.begin(), options.cut_tolerances.end());
  auto& tolerances = options.cut_tolerances;
  tolerances.erase(std::unique(tolerances.begin(), tolerances.end()), tolerances.end());
  if (tolerances.empty() || tolerances.front() != 0) tolerances.insert(tolerances.begin(), 0.0);
  return {};
}

Plan static_plan(const Options& options) {
  Plan plan;
  for (const SceneKind& kind : scene_kinds()) {
    const auto& asked = options.scenes;
    if (!asked.empty() && std::find(asked.begin(), asked.end(), kind.name) == asked.end()) continue;
    const std::vector<double> own{static_cast<double>(kind.points)};
    for (const double points : options.points.empty() ? own : options.points)
      for (const int parts : options.parts)
        plan.cells.push_back({kind.name, static_cast<std::uint64_t>(points), parts});
  }
  plan.wish = {options.methods, options.cut_tolerances, true};
  plan.repeats = options.repeats;
  return plan;
}

// From the first number of points on: all part counts at that size, all sizes at the first part count.
Plan scaling_plan(const Options& options) {
  Plan plan;
  const std::vector<std::string> scenes = options.scenes.empty() ? std::vector<std::string>{"uniform"} : options.scenes;
  for (const std::string& scene : scenes)
    for (std::size_t s = 0; s < options.points.size(); ++s)
      for (std::size_t p = 0; p < (s == 0 ? options.parts.size() : 1); ++p)
        plan.cells.push_back({scene, static_cast<std::uint64_t>(options.points[s]), options.parts[p]});
  plan.wish = {options.methods, {0.0}, false};
  plan.repeats = options.repeats;
  plan.memory = true;
  return plan;
}

// Writes and prints what there is, also of a run that failed half-way.
Status tell(const std::string& bench, const Options& options, Json document, const Rows& result) {
  document["rows"] = result.rows;
  document["summary"] = bench == "static" ? summarise_static(result.rows) : summarise_scaling(result.rows);
  print(bench == "static" ? static_tables(document) : scaling_tables(document));
  if (Status status = write_result(options.json, document); !status.ok()) return status;
  if (!result.status.ok()) return result.status;
  if (!options.figure.empty())
    if (Status status = draw(document, options.figure); !status.ok()) return status;
  return verdict(document);
}

Json start_document(const std::string& bench, int repeats) {
  return {{"bench", bench},
          {"commit", RCB_COMMIT},
          {"version", RCB_VERSION},
          {"machine", describe_machine()},
          {"peers", describe_peers()},
          {"repeats", repeats}};
}

Status run(const std::string& bench, Options& options) {
  if (Status status = check(options); !status.ok()) return status;
  Json document = start_document(bench, options.repeats);
  fmt::print(stderr, "rcb_bench {}: commit {}, {}\n", bench, RCB_COMMIT, describe_peers());
  const Plan plan = bench == "static" ? static_plan(options) : scaling_plan(options);
  return tell(bench, options, std::move(document), run_jobs(plan, options.ranks));
}

void add_options(CLI::App& command, Options& options) {
  add_list(command, "--parts", options.parts, "numbers of parts");
  add_list(command, "--ranks", options.ranks, "numbers of MPI ranks, one job each");
  add_list(command, "--scenes", options.scenes, "scenes (default: all of this bench)");
  add_list(command, "--methods", options.methods,
           "ours: rcb, bands-x, -y, -z; peers: RCB, RIB, HSFC, MJ; read: the floor, each coordinate read once");
  command.add_option("--repeats", options.repeats, "timed runs of each contender")->capture_default_str();
  command.add_option("--json", options.json, "write the result to this file");
}

std::string scene_list() {
  std::string text = "Scenes:\n";
  for (const SceneKind& kind : scene_kinds())
    text += fmt::format("  {:<16} {}; {} points\n", kind.name, kind.what, kind.points);
  return text + '\n';
}

// The examples of one subcommand; empty: of all.
std::string examples(const std::string& subcommand) {
  std::string text = "Examples:\n";
  for (const std::string line :
       {"static --json static.json --figure static.svg", "static --scenes uniform,offset --parts 8 --ranks 2",
        "static --ranks 2 --parts 8,64 --methods rcb --cut-tolerances 0 --points 1e6,2e6,4e6,8e6,16e6",
        "scaling --json scaling.json", "dynamic --json dynamic.json --figure dynamic.svg", "slope --json slope.json",
        "step --json step.json", "step --hosts 2 --latency 1 --bandwidth 1",
        "memory --points 10000000 --ranks 2 --json memory.json", "skips --json skips.json", "drift --json drift.json",
        "cuts --parts 64 --json cuts.json", "idle --ranks 8",
        "hosts --hosts 2,3 --latency 0.5,5 --bandwidth 10,1 --json hosts.json"})
    if (line.starts_with(subcommand)) text += "  rcb_bench " + line + '\n';
  return text;
}

int drive(int argc, char** argv) {
  CLI::App app("Times the partitioner beside its peers: starts mpirun itself, runs the contenders in turn.",
               "rcb_bench");
  app.set_version_flag("--version", std::string("rcb_bench " RCB_VERSION " (" RCB_COMMIT "), " + describe_peers()));
  app.require_subcommand(1);
  app.footer(scene_list() + examples(""));
  Options of_static, of_scaling;
  of_static.parts = {8, 64, 1024};
  of_static.methods = kMethods;
  auto* statics = app.add_subcommand("static", "time of one partition against its error, for every method and peer");
  add_options(*statics, of_static);
  add_list(*statics, "--cut-tolerances", of_static.cut_tolerances,
           "our cut tolerances; 0, the exact run, is always there");
  statics->add_option("--points", of_static.points, "numbers of points of every scene, instead of its own number")
      ->delimiter(',');
  statics->add_option("--figure", of_static.figure,
                      "draw run time against error as SVG (its gnuplot source beside it)");
  of_scaling.parts = {8, 64, 512, 4096};
  of_scaling.methods = {"rcb", "read", "RCB", "MJ"};
  of_scaling.points = {1e6, 2e6, 4e6, 8e6, 16e6};
  of_scaling.repeats = 3;
  auto* scaling = app.add_subcommand("scaling", "time and memory per particle for more particles, parts and ranks");
  add_options(*scaling, of_scaling);
  add_list(*scaling, "--points", of_scaling.points, "numbers of points; all parts are run with the first");
  DynamicOptions of_dynamic;
  const auto* dynamic = add_dynamic(app, of_dynamic);
  SlopeBenchOptions of_slope;
  const auto* slope = add_slope(app, of_slope);
  StepBenchOptions of_step;
  const auto* step = add_step(app, of_step);
  MemoryOptions of_memory;
  const auto* memory = add_memory(app, of_memory);
  SkipsOptions of_skips;
  const auto* skips = add_skips(app, of_skips);
  DriftOptions of_drift;
  const auto* drift = add_drift(app, of_drift);
  IdleOptions of_idle;
  const auto* idle = add_idle(app, of_idle);
  CutsBenchOptions of_cuts;
  const auto* cuts = add_cuts(app, of_cuts);
  HostsOptions of_hosts;
  const auto* hosts = add_hosts(app, of_hosts);
  for (CLI::App* subcommand : app.get_subcommands({})) {
    const std::string name = subcommand->get_name();
    const bool of_scenes = name == "static" || name == "scaling" || name == "drift";
    subcommand->footer((of_scenes ? scene_list() : "") + examples(name));
  }
  return run_program(app, argc, argv, [&] {
    if (hosts->parsed()) return run_hosts(of_hosts, start_document("hosts", of_hosts.repeats));
    if (cuts->parsed()) return run_cuts(of_cuts, start_document("cuts", of_cuts.repeats));
    if (idle->parsed()) return run_idle(of_idle, start_document("idle", 1));
    if (drift->parsed()) return run_drift(of_drift, start_document("drift", of_drift.repeats));
    if (slope->parsed()) return run_slope(of_slope, start_document("slope", of_slope.repeats));
    if (step->parsed() && !of_step.links.hosts.empty())
      return run_hosts(over_links(of_step), start_document("step", of_step.repeats));
    if (step->parsed()) return run_step(of_step, start_document("step", of_step.repeats));
    if (memory->parsed()) return run_memory(of_memory, start_document("memory", 1));
    if (skips->parsed()) return run_skips(of_skips, start_document("skips", of_skips.repeats));
    if (dynamic->parsed()) return run_dynamic(of_dynamic, start_document("dynamic", of_dynamic.repeats));
    return statics->parsed() ? run("static", of_static) : run("scaling", of_scaling);
  });
}

}  // namespace
}  // namespace rcb::bench

int main(int argc, char** argv) {
  try {
    if (argc > 1 && std::string(argv[1]) == rcb::bench::kWorkerWord) return rcb::bench::run_worker(argc, argv);
    if (argc > 1 && std::string(argv[1]) == rcb::bench::kPeerWord) return rcb::bench::run_peer_worker(argc, argv);
    if (argc > 1 && std::string(argv[1]) == rcb::bench::kDriftWord) return rcb::bench::run_drift_worker(argc, argv);
    return rcb::bench::drive(argc, argv);
  } catch (const std::exception& error) {
    fmt::print(stderr, "rcb_bench: {}\n", error.what());
    return 1;
  }
}
