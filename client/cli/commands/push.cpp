// push: one step from a file.
#include <numeric>

#include <fmt/format.h>

#include "client/cli/app.hpp"
#include "client/cli/files/frame_pusher.hpp"
#include "client/cli/files/point_file.hpp"
#include "client/cli/print/output.hpp"
#include "common/wire/limits.hpp"

namespace rcb::cli {
namespace {

struct PushOptions {
  std::string name;
  FileOptions file;
  std::uint64_t inserted = 0, removed = 0;
  std::optional<std::int64_t> step;
  std::optional<double> step_seconds;
  bool force = false;
};

void print_report(const Json& report) {
  Facts facts;
  facts.add("step", fmt::format("{}, epoch {}", text_of(report, "step"), text_of(report, "epoch")));
  const Json& before = report.at("error_before");
  facts.add("error", fmt::format("{}{}, imbalance {}", before.is_null() ? "" : text_of(before) + " on arrival, now ",
                                 text_of(report, "error"), text_of(report, "imbalance")));
  facts.add("repartition", fmt::format("{}: {}", text_of(report, "repartitioned"), text_of(report, "reason")));
  facts.add("points", fmt::format("{} drifted, {} moved, {} migrated", text_of(report, "drifted"),
                                  text_of(report, "moved"), text_of(report, "migrated")));
  facts.add("way", text_of(report, "way"));
  facts.add("skipped", text_of(report, "skipped"));
  facts.add("time", milliseconds(report.at("seconds").at("total").get<double>()) + " ms");
  facts.print();
}

Result<io::Points> read_for_scene(const FileOptions& file, int dims, const std::string& scene) {
  auto points = read_single(file);
  if (!points || file.dims != 0 || points->dims == dims || points->count == 0) return points;
  return Status(
      Code::invalid_argument,
      fmt::format("{}: its points have {} dimension{}, scene '{}' has {}", file.path, points->dims,
                  points->dims == 1 ? "" : "s", scene, dims),
      points->dims > dims
          ? fmt::format("say with --columns which of its columns are the positions (--dims {}: the first)", dims)
          : fmt::format("create the scene with --dims {}, or give a file with more columns", points->dims));
}

// A file without ids counts its rows.
std::vector<std::int64_t> ids_of(const io::Points& points, const PushOptions& options) {
  std::vector<std::int64_t> ids = points.id;
  if (ids.empty() && options.inserted + options.removed > 0) {
    ids.resize(points.count);
    std::iota(ids.begin(), ids.end(), 0);
  }
  return ids;
}

Status push(const PushOptions& options, const Context& context) {
  auto client = connect(context);
  if (!client) return client.status();
  auto shown = ask(*client, "scene.show", {{"scene", options.name}});
  if (!shown) return shown.status();
  if (!options.force) {
    Status free = check_not_held(*shown, options.name,
                                 "try again when it is closed; with --force the step is pushed all the same, and a "
                                 "solver whose next step has the same number fails");
    if (!free) return free;
  }
  Progress progress("push " + options.name);
  progress.stage("reading " + options.file.path);
  const auto points = read_for_scene(options.file, shown->at("dims").get<int>(), options.name);
  if (!points) return points.status();
  if (points->count == 0 && shown->at("n") == 0) return no_points(options.file.path, options.name);
  if (points->count > 0 && points->weight.empty() && shown->at("weights").get<bool>())
    return {Code::invalid_argument,
            fmt::format("{}: no weights, and scene '{}' has them", options.file.path, options.name),
            "name the file's column: --weights w"};
  progress.stage("waiting for the step");
  auto scene = client->open_scene(options.name);
  if (!scene) return scene.status();
  client::StepOptions step;
  step.step = options.step;
  const auto ids = ids_of(*points, options);
  step.ids = ids;
  step.weights = points->weight;
  step.inserted = options.inserted;
  step.removed = options.removed;
  step.step_seconds = options.step_seconds;
  const CompactPositions sent(*points);
  auto result = scene->step(sent.positions(), step);
  progress.clear();
  if (result.status().code() == Code::not_conserved)
    return {Code::not_conserved, result.status().message(),
            "say with --inserted N and --removed M how many came and went, or create the scene anew with --replace"};
  if (!result) return result.status();
  const Json report = Json::parse(result->report.json);
  note_empty_parts(result->report.n, result->report.parts);
  note_lost_weights(report);
  return show(context, report, [&] { print_report(report); });
}

}  // namespace

void add_push_command(CLI::App& app, Context& context) {
  auto [pushes, pushed] = add_command(app, context,
                                      {"push", "One step from a file",
                                       "  rcbctl push jet step0.csv\n  rcbctl push jet step7.npy --step 7\n"
                                       "  rcbctl push jet step8.csv --inserted 20 --removed 3",
                                       kSceneGroup},
                                      push);
  add_scene_name(pushes, pushed.name);
  add_file_options(pushes, pushed.file);
  add_value(pushes, "--inserted", pushed.inserted, kind::whole_number("N", 0),
            "particles of FILE that weren't in the last step; without this and --removed it must have the same");
  add_value(pushes, "--removed", pushed.removed, kind::whole_number("M", 0),
            "particles of the last step that aren't in FILE");
  add_value(pushes, "--step", pushed.step, kind::whole_number("K", 0, wire::kStepMax),
            "its number (default: the last + 1, 0 at first)");
  add_value(pushes, "--step-seconds", pushed.step_seconds, kind::number_from_zero("SECONDS"), kStepSecondsHelp);
  pushes.add_flag(
      "--force", pushed.force,
      "push also while a solver has the scene open; without it that is refused, since the solver's next step "
      "would fail");
}

}  // namespace rcb::cli
