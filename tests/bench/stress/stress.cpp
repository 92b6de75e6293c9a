// rcb_stress: where arithmetic breaks a partitioner, and ours doesn't. Nasty scenes, small and large, on several
// numbers of ranks, for the engine and its peers; also the MPI program that it starts for that (stress_worker.hpp).
#include <cmath>
#include <cstdio>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "rcb_bench_commit.hpp"
#include "tests/bench/driver.hpp"
#include "tests/bench/json.hpp"
#include "tests/bench/options.hpp"
#include "tests/bench/report.hpp"
#include "tests/bench/stress/stress_report.hpp"
#include "tests/bench/stress/stress_scenes.hpp"
#include "tests/bench/stress/stress_worker.hpp"
#include "tests/bench/worker.hpp"

namespace rcb::bench {
namespace {

constexpr double kPointsMax = 1e8;
constexpr int kStressPartsMax = 1 << 16;
constexpr int kStressRanksMax = 64;

struct Options {
  std::vector<double> points{1000, 100000};
  std::vector<int> parts{7, 64, 1000};
  std::vector<int> ranks{1, 2, 4};
  std::vector<std::string> scenes;
  std::vector<std::string> methods{
      "rcb",
#ifdef RCB_BENCH_ZOLTAN
      "RCB",
      "HSFC",
#endif
#ifdef RCB_BENCH_ZOLTAN2
      "MJ",
#endif
  };
  double timeout = 20;
  bool quick = false;
  std::string json;
};

std::string tool_of(const std::string& method) {
  return method == "MJ" ? "Zoltan2" : std::isupper(static_cast<unsigned char>(method[0])) != 0 ? "Zoltan" : "rcbd";
}

Status check(const Options& options) {
  OptionCheck check("rcb_stress");
  check.whole("--points", options.points, 0, kPointsMax);
  check.between("--parts", options.parts, 1, kStressPartsMax);
  check.between("--ranks", options.ranks, 1, kStressRanksMax);
  check.known("--scenes", options.scenes, [](const std::string& scene) { return find_stress_scene(scene) != nullptr; });
  for (const std::string& method : options.methods) {
    const auto& known = Options{}.methods;
    check.holds(std::find(known.begin(), known.end(), method) != known.end(),
                fmt::format("--methods {}: this build has {}", method, fmt::join(known, ", ")));
  }
  check.holds(options.timeout > 0, "--timeout: give seconds");
  return check.status();
}

std::vector<Cell> make_cells(const Options& options) {
  std::vector<Cell> cells;
  for (const StressScene& scene : stress_scenes()) {
    const auto& asked = options.scenes;
    if (!asked.empty() && std::find(asked.begin(), asked.end(), scene.name) == asked.end()) continue;
    for (const double points : options.points)
      for (const int parts : options.parts) cells.push_back({scene.name, static_cast<std::uint64_t>(points), parts});
  }
  return cells;
}

// The rows of one method on one number of ranks. A job that ends or hangs in a cell costs that cell alone: the next job
// begins behind it. Errors: aborted, io_error.
Status run_method(const Options& options, const std::string& folder, const std::string& method, int ranks, Json& out) {
  const std::vector<Cell> cells = make_cells(options);
  const double stall = tool_of(method) == "rcbd" ? kStallSeconds : options.timeout;
  std::size_t first = 0;
  const auto tell = [&](Json row) {
    const Cell& cell = cells[first++];
    Json told{{"scene", cell.scene}, {"n", cell.n},    {"dims", find_stress_scene(cell.scene)->dims},
              {"parts", cell.parts}, {"ranks", ranks}, {"tool", tool_of(method)},
              {"method", method}};
    row.erase("cell");
    told.update(row);
    out.push_back(std::move(told));
  };
  while (first < cells.size()) {
    Plan plan;
    plan.cells.assign(cells.begin() + static_cast<std::ptrdiff_t>(first), cells.end());
    plan.wish = {{method}, {0.0}, false};
    if (Status status = save(plan, folder + "/plan"); !status.ok()) return status;
    fmt::print(stderr, "{} {}, {} rank(s): {} cells\n", tool_of(method), method, ranks, plan.cells.size());
    Json rows = Json::array();
    const Status status = run_job(folder, kWorkerWord, ranks, stall, rows);
    if (status.code() == Code::aborted) return status;
    for (Json& row : rows)
      if (row.contains("cell")) tell(std::move(row));
    if (first < cells.size())
      tell({{"failure", status.code() == Code::deadline_exceeded ? fmt::format("no answer in {} s", stall)
                        : status.ok()                            ? std::string("ends without an answer")
                                                                 : "crashes: " + status.message()}});
  }
  return {};
}

Status run(Options& options) {
  if (options.quick) {
    options.points = {50, 2000};
    options.parts = {7, 64};
    options.ranks = {1, 3};
  }
  if (Status status = check(options); !status.ok()) return status;
  const TemporaryFolder folder;
  if (folder.path().empty()) return {Code::io_error, "no temporary folder can be made", "see TMPDIR"};
  prepare_jobs();
  Json document{{"bench", "stress"},         {"commit", RCB_COMMIT},
                {"version", RCB_VERSION},    {"machine", describe_machine()},
                {"peers", describe_peers()}, {"rows", Json::array()}};
  Status status;
  for (const std::string& method : options.methods)
    for (const int ranks : options.ranks)
      if (status.ok()) status = run_method(options, folder.path(), method, ranks, document["rows"]);
  compare_ranks(document["rows"]);
  print(stress_table(document));
  if (Status written = write_result(options.json, document); !written.ok()) return written;
  return status.ok() ? stress_verdict(document) : status;
}

std::string footer() {
  std::string text = "Scenes:\n";
  for (const StressScene& scene : stress_scenes()) text += fmt::format("  {:<16} {}\n", scene.name, scene.what);
  return text + "\nExit code 1 if anything of ours is wrong; peers may be as wrong as they are.\n";
}

int drive(int argc, char** argv) {
  CLI::App app("Stresses the partitioner's arithmetic, and its peers': starts mpirun itself.", "rcb_stress");
  app.set_version_flag("--version", std::string("rcb_stress " RCB_VERSION " (" RCB_COMMIT "), " + describe_peers()));
  app.footer(footer());
  Options options;
  add_list(app, "--points", options.points, "numbers of points of each scene");
  add_list(app, "--parts", options.parts, "numbers of parts");
  add_list(app, "--ranks", options.ranks, "numbers of MPI ranks");
  add_list(app, "--scenes", options.scenes, "scenes (default: all)");
  add_list(app, "--methods", options.methods, "ours: rcb; peers: RCB, HSFC, MJ");
  app.add_option("--timeout", options.timeout, "seconds for which a peer is waited")->capture_default_str();
  app.add_flag("--quick", options.quick, "50 and 2000 points, 7 and 64 parts, 1 and 3 ranks");
  app.add_option("--json", options.json, "write the result to this file");
  return run_program(app, argc, argv, [&options] { return run(options); });
}

}  // namespace
}  // namespace rcb::bench

int main(int argc, char** argv) {
  try {
    if (argc > 1 && std::string(argv[1]) == rcb::bench::kWorkerWord) return rcb::bench::run_stress_worker(argc, argv);
    return rcb::bench::drive(argc, argv);
  } catch (const std::exception& error) {
    fmt::print(stderr, "rcb_stress: {}\n", error.what());
    return 1;
  }
}
