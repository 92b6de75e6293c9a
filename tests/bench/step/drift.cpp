#include "tests/bench/step/drift.hpp"

#include <algorithm>
#include <map>

#include <fmt/format.h>

#include "tests/bench/driver.hpp"
#include "tests/bench/json.hpp"
#include "tests/bench/measure.hpp"
#include "tests/bench/options.hpp"
#include "tests/bench/report.hpp"
#include "tests/bench/scenes.hpp"

namespace rcb::bench {
namespace {

Status check(const DriftOptions& options) {
  OptionCheck check("rcb_bench drift");
  check.known("--scenes", options.scenes, [](const std::string& scene) { return find_scene_kind(scene) != nullptr; });
  check.between("--parts", options.parts, 2, kPartsMax);
  check.between("--ranks", options.ranks, 1, kRanksMax);
  for (const double share : options.crossed)
    check.holds(share > 0 && share < 1, fmt::format("--crossed {}: give a share between 0 and 1", share));
  check.between("--repeats", std::vector{options.repeats}, 1, kRepeatsMax);
  return check.status();
}

// Adds medians and their ratios, warm to cold in pairs. False where the two don't agree.
bool compare(Json& row) {
  Json& ways = row["ways"];
  const auto read = row["read"].get<std::vector<double>>();
  for (Json& way : ways) {
    const auto seconds = way["seconds"].get<std::vector<double>>();
    way["median"] = median(seconds);
    std::vector<double> to_read;
    for (std::size_t r = 0; r < seconds.size(); ++r) to_read.push_back(seconds[r] / read[r]);
    way["times_read"] = median(to_read);
  }
  bool same = true;
  for (std::size_t w = 0; w + 1 < ways.size(); w += 2) {
    const auto incremental = ways[w]["seconds"].get<std::vector<double>>();
    const auto full = ways[w + 1]["seconds"].get<std::vector<double>>();
    std::vector<double> ratios;
    for (std::size_t r = 0; r < incremental.size(); ++r) ratios.push_back(full[r] / incremental[r]);
    ways[w]["times_faster"] = median(ratios);
    same = same && ways[w]["hash"] == ways[w + 1]["hash"] && ways[w]["moved"] == ways[w + 1]["moved"];
  }
  return same;
}

std::string drift_tables(const Json& rows) {
  std::vector<std::vector<std::string>> lines{{"scene", "ranks", "parts", "way", "ms", "times faster", "times read",
                                               "crossed", "moved", "looked at", "axes flipped", "error before",
                                               "after"}};
  for (const Json& row : rows)
    for (const Json& way : row["ways"]) {
      const auto n = row["n"].get<double>();
      lines.push_back({row["scene"].get<std::string>(), row["ranks"].dump(), row["parts"].dump(),
                       way["way"].get<std::string>(), fmt::format("{:.2f}", 1e3 * way["median"].get<double>()),
                       way.contains("times_faster") ? fmt::format("{:.1f}", way["times_faster"].get<double>()) : "",
                       fmt::format("{:.1f}", way["times_read"].get<double>()),
                       fmt::format("{:.2f} %", 100 * row["crossed"].get<double>()),
                       fmt::format("{:.2f} %", 100 * way["moved"].get<double>() / n),
                       fmt::format("{:.1f} %", 100 * way["looked_at"].get<double>() / n), way["axes_flipped"].dump(),
                       fmt::format("{:.3f}", row["error_before"].get<double>()),
                       fmt::format("{:.2g}", way["error"].get<double>())});
    }
  return table(lines, 1);
}

}  // namespace

CLI::App* add_drift(CLI::App& app, DriftOptions& options) {
  auto* drift = app.add_subcommand("drift", "new cuts after a drift: from the cuts in force, and among all particles");
  add_list(*drift, "--scenes", options.scenes, "scenes");
  add_list(*drift, "--parts", options.parts, "numbers of parts");
  add_list(*drift, "--ranks", options.ranks, "numbers of ranks");
  add_list(*drift, "--crossed", options.crossed, "shares of the particles that cross a cut");
  drift->add_option("--repeats", options.repeats, "timed runs of each")->capture_default_str();
  drift->add_option("--json", options.json, "write everything measured to this file");
  return drift;
}

Status run_drift(const DriftOptions& options, Json document) {
  if (Status status = check(options); !status.ok()) return status;
  const TemporaryFolder folder;
  if (folder.path().empty()) return {Code::io_error, "no temporary folder can be made", "see TMPDIR"};
  Plan plan;
  for (const std::string& scene : options.scenes)
    for (const int parts : options.parts) plan.cells.push_back({scene, find_scene_kind(scene)->points, parts});
  plan.wish.cut_tolerances = options.crossed;
  plan.repeats = options.repeats;
  Status status = save(plan, folder.path() + "/plan");
  prepare_jobs();
  Json rows = Json::array();
  for (const int ranks : options.ranks)
    if (status.ok()) status = run_job(folder.path(), kDriftWord, ranks, kStallSeconds, rows);
  bool same = true;
  for (Json& row : rows) same = compare(row) && same;
  print(drift_tables(rows));
  document["rows"] = std::move(rows);
  if (Status written = write_result(options.json, document); !written.ok()) return written;
  if (status.ok() && !same)
    status = {Code::internal, "cuts from those in force differ from those of a search among all"};
  return status;
}

}  // namespace rcb::bench
