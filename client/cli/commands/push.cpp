// push: one step from a file.
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
  bool subset = false;
  bool unmoved = false;
  FileOptions inserted;
  std::vector<std::int64_t> removed;
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

Status push(const PushOptions& options, const Context& context) {
  if (options.file.path.empty() && !options.unmoved && options.inserted.path.empty() && options.removed.empty())
    return {Code::usage, "push: FILE, --unmoved, --insert or --remove is wanted", "rcbctl push --help"};
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
  const int dims = shown->at("dims").get<int>();
  Progress progress("push " + options.name);
  const auto read = [&](const FileOptions& file) -> Result<io::Points> {
    if (file.path.empty()) return io::Points{.dims = dims};
    progress.stage("reading " + file.path);
    return read_for_scene(file, dims, options.name);
  };
  const auto points = read(options.file);
  if (!points) return points.status();
  if (points->count == 0 && !options.file.path.empty() && shown->at("n") == 0)
    return no_points(options.file.path, options.name);
  FileOptions new_file = options.file;
  new_file.path = options.inserted.path;
  const auto inserted = read(new_file);
  if (!inserted) return inserted.status();
  if (inserted->count > 0 && inserted->weight.empty() && shown->at("weights").get<bool>())
    return {Code::invalid_argument,
            fmt::format("{}: no weights, and scene '{}' has them", options.inserted.path, options.name),
            "name the file's column: --weights w"};
  if (options.subset && points->id.size() != points->count)
    return {Code::invalid_argument, fmt::format("{}: no column 'id' says which particles moved", options.file.path),
            "name the columns, as in \"id,x,y,z\""};
  progress.stage("waiting for the step");
  auto scene = client->open_scene(options.name);
  if (!scene) return scene.status();
  client::StepOptions step;
  step.step = options.step;
  step.step_seconds = options.step_seconds;
  step.weights = points->weight;
  const CompactPositions sent(*points), new_sent(*inserted);
  const bool alone = options.file.path.empty();
  const bool single = alone ? new_sent.single() : sent.single() && (inserted->count == 0 || new_sent.single());
  const client::Insertion insertion{new_sent.positions(single && inserted->count > 0), inserted->id, inserted->weight};
  if (inserted->count > 0) step.inserted = &insertion;
  step.removed = options.removed;
  if (!options.subset) step.ids = points->id;
  auto result = alone            ? scene->step_unmoved(step)
                : options.subset ? scene->step_moved(points->id, sent.positions(single), step)
                                 : scene->step(sent.positions(single), step);
  progress.clear();
  if (!result) return result.status();
  const Json report = Json::parse(result->report.json);
  note_empty_parts(result->report.n, result->report.parts);
  note_lost_weights(report);
  return show(context, report, [&] { print_report(report); });
}

}  // namespace

void add_push_command(CLI::App& app, Context& context) {
  auto [pushes, pushed] =
      add_command(app, context,
                  {"push", "One step from a file",
                   "  rcbctl push jet step0.csv\n  rcbctl push jet step7.npy --step 7\n"
                   "  rcbctl push jet moved.csv --subset\n  rcbctl push jet --insert inflow.csv --remove 17,42",
                   kSceneGroup},
                  push);
  add_scene_name(pushes, pushed.name);
  CLI::Option* file = add_file_options(pushes, pushed.file);
  file->required(false);
  CLI::Option* unmoved = pushes.add_flag("--unmoved", pushed.unmoved, "nothing moved; no FILE");
  unmoved->excludes(file);
  pushes.add_flag("--subset", pushed.subset, "FILE holds only the particles that moved: columns id,x,y,z")->needs(file);
  add_value(pushes, "--insert", pushed.inserted.path, kind::text("FILE"),
            "a file of particles to add; ids of its own, or the service chooses them; options of columns hold for both "
            "files");
  add_list(pushes, "--remove", pushed.removed, kind::whole_number("IDS", 0),
           "ids of particles to remove, with commas between");
  add_value(pushes, "--step", pushed.step, kind::whole_number("K", 0, wire::kStepMax),
            "its number (default: the last + 1, 0 at first)");
  add_value(pushes, "--step-seconds", pushed.step_seconds, kind::number_from_zero("SECONDS"), kStepSecondsHelp);
  pushes.add_flag(
      "--force", pushed.force,
      "push also while a solver has the scene open; without it that is refused, since the solver's next step "
      "would fail");
}

}  // namespace rcb::cli
