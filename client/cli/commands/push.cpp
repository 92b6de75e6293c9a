// push, replay: steps from files.
#include <algorithm>

#include <fmt/format.h>

#include "client/cli/app.hpp"
#include "client/cli/files/frame_order.hpp"
#include "client/cli/files/point_file.hpp"
#include "client/cli/interrupt.hpp"
#include "client/cli/print/output.hpp"
#include "client/cli/print/report_csv.hpp"
#include "common/base/clock.hpp"
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
};

struct ReplayOptions {
  std::string name;
  std::vector<std::string> files;
  FileOptions file;  // the columns of each file
  std::optional<int> parts;
  client::SceneOptions scene;  // but for its parts and dims
  std::optional<double> step_seconds;
  std::string history;
};

// Positions that float32 represents exactly are sent as float32: half the bytes, the same values.
class CompactPositions {
 public:
  explicit CompactPositions(const io::Points& points) : points_(points) {
    for (const auto& axis : points.position)
      for (const double value : axis)
        if (static_cast<double>(static_cast<float>(value)) != value) return;
    for (const auto& axis : points.position) single_.emplace_back(axis.begin(), axis.end());
  }
  bool single() const { return !single_.empty() && points_.count > 0; }
  client::Positions positions(bool as_single) const {
    if (!as_single) return positions_of(points_);
    std::vector<const float*> axes;
    for (const auto& axis : single_) axes.push_back(axis.data());
    return client::Positions::axes(axes, points_.count);
  }
  client::Positions positions() const { return positions(single()); }

 private:
  const io::Points& points_;
  std::vector<std::vector<float>> single_;
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
  facts.add("skipped", text_of(report, "skipped"));
  facts.add("time", milliseconds(report.at("seconds").at("total").get<double>()) + " ms");
  facts.print();
}

// Such a push would make a scene without particles, which is hardly meant.
Status no_points(const std::string& file, const std::string& scene) {
  return {Code::invalid_argument, fmt::format("{}: holds no points, and scene '{}' has none yet", file, scene),
          "push a file that holds some; was this one written to its end?"};
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

// Puts rows that have ids in the order of the first file's rows, since each file may have an order of its own.
// first: the rows of the first file by id.
void sort_like(const std::vector<std::size_t>& first, io::Points& points) {
  if (points.id.empty() || points.id.size() != first.size()) return;
  const std::vector<std::size_t> rows = rows_by_id(points);
  const auto sort = [&](auto& values) {
    auto sorted = values;
    for (std::size_t k = 0; k < values.size(); ++k) sorted[first[k]] = values[rows[k]];
    values = std::move(sorted);
  };
  for (auto& axis : points.position) sort(axis);
  sort(points.weight);
  sort(points.id);
}

// Sums over a replay so far.
struct Tally {
  Json reports = Json::array();
  std::uint64_t repartitions = 0;
  double error_sum = 0;
  double error_max = 0;
};

void add(Tally& tally, const client::StepReport& report) {
  tally.reports.push_back(Json::parse(report.json));
  if (report.repartitioned && report.error_before) ++tally.repartitions;
  const double error = report.error_before.value_or(report.error);
  tally.error_sum += error;
  tally.error_max = std::max(tally.error_max, error);
}

class Replay {
 public:
  Replay(const ReplayOptions& options, const Context& context)
      : options_(options), context_(context), progress_("replay " + options.name) {}

  Status run() {
    if (Status status = check_not_overwritten("--history", options_.history, options_.files); !status) return status;
    auto client = connect_persistent(context_);
    if (!client) return client.status();
    const double start = clock_.seconds();
    Status status;
    const FrameOrder order = in_frame_order(options_.files);
    if (!order.changed.empty()) note(order.changed);
    for (const std::string& file : order.files)
      if (status = replay_file(*client, file); !status) break;
    progress_.clear();
    // The steps before a bad frame, or before Ctrl-C, are committed, so their history is written, too.
    if (!options_.history.empty() && !tally_.reports.empty()) {
      std::string table = reports_csv_header();
      for (const Json& report : tally_.reports) table += report_csv_line(report);
      if (Status written = io::write_file(options_.history, table); !written) return written;
      if (!status)
        note(fmt::format("{} has the reports of the {} steps before", options_.history, tally_.reports.size()));
    }
    if (!status) return status;
    note_empty_parts(tally_.reports.back().at("n").get<std::uint64_t>(), parts_);
    note_lost_weights(tally_.reports.back());
    return show_end(clock_.seconds() - start);
  }

 private:
  Status replay_file(client::Client& client, const std::string& path) {
    FileOptions file = options_.file;
    file.path = path;
    if (options_.files.size() == 1) progress_.stage("reading " + path);
    auto reader = io::open_trajectory(path, read_options(file));
    if (interrupted()) return stopped();
    if (!reader) return reader.status();
    const std::uint64_t frames = (*reader)->frames();
    if (frames == 0) return {Code::invalid_argument, path + ": holds no frames", "save at least one step in it"};
    for (std::uint64_t k = 0; k < frames; ++k) {
      auto points = (*reader)->frame(k);
      if (interrupted()) return stopped();
      if (!points) return points.status();
      if (!scene_ && points->count == 0) return no_points(path, options_.name);
      if (!scene_) first_rows_ = rows_by_id(*points);
      sort_like(first_rows_, *points);
      if (!scene_)
        if (Status status = open(client, *points); !status) return status;
      client::StepOptions step;
      step.step = static_cast<std::int64_t>(tally_.reports.size());
      step.step_seconds = options_.step_seconds;
      step.weights = points->weight;
      step.ids = points->id;
      const CompactPositions sent(*points);
      auto result = scene_->step(sent.positions(), step);
      if (result.status().code() == Code::interrupted)
        return interruption(fmt::format("during step {}, which the service may still do; the {} before it stand",
                                        tally_.reports.size(), tally_.reports.size()));
      if (!result)
        return {result.status().code(),
                fmt::format("{}, frame {} (step {}): {}", path, k, tally_.reports.size(), result.status().message()),
                result.status().hint()};
      add(tally_, result->report);
      const std::uint64_t total = options_.files.size() == 1 ? frames : options_.files.size();
      progress_.at(tally_.reports.size(), total, "error " + number(result->report.error));
    }
    return {};
  }

  // Between two steps.
  Status stopped() const {
    const std::size_t steps = tally_.reports.size();
    return interruption(fmt::format("after {} step{}{}", steps, steps == 1 ? "" : "s",
                                    steps == 0 ? "" : fmt::format(", which stand in scene '{}'", options_.name)));
  }

  Status open(client::Client& client, const io::Points& points) {
    client::SceneOptions scene = options_.scene;
    const int parts = scene.part_sizes.empty() ? client.ranks() : static_cast<int>(scene.part_sizes.size());
    scene.parts = parts_ = options_.parts.value_or(parts);
    scene.dims = points.dims;
    if (Status status = client.create_scene(options_.name, scene); !status) return status;
    auto opened = client.open_scene(options_.name);
    if (!opened) return opened.status();
    scene_.emplace(std::move(*opened));
    return {};
  }

  Status show_end(double seconds) const {
    const double mean = tally_.reports.empty() ? 0 : tally_.error_sum / static_cast<double>(tally_.reports.size());
    const double tolerance = options_.scene.tolerance;
    return show(context_,
                {{"scene", options_.name},
                 {"steps", tally_.reports.size()},
                 {"parts", parts_},
                 {"tolerance", tolerance_json(tolerance)},
                 {"policy", options_.scene.policy},
                 {"repartitions", tally_.repartitions},
                 {"error_mean", mean},
                 {"error_max", tally_.error_max},
                 {"seconds", seconds},
                 {"last", tally_.reports.empty() ? Json() : tally_.reports.back()}},
                [&] {
                  Facts facts;
                  facts.add("scene", fmt::format("{}, {} parts, tolerance {}", options_.name, parts_, tolerance));
                  facts.add("steps", std::to_string(tally_.reports.size()));
                  facts.add("repartitions", fmt::format("{} after the first partition", tally_.repartitions));
                  facts.add("error", fmt::format("mean {}, largest {} (as found when a step arrived)", number(mean),
                                                 number(tally_.error_max)));
                  facts.add("time", fmt::format("{:.3g} s", seconds));
                  facts.print();
                });
  }

  const ReplayOptions& options_;
  const Context& context_;
  SteadyClock clock_;
  Progress progress_;
  Tally tally_;
  int parts_ = 0;
  std::vector<std::size_t> first_rows_;  // of the first file, by id
  std::optional<client::Scene> scene_;
};

Status replay(const ReplayOptions& options, const Context& context) { return Replay(options, context).run(); }

}  // namespace

void add_push_commands(CLI::App& app, Context& context) {
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

  auto [replays, replayed] =
      add_command(app, context,
                  {"replay", "Makes a scene and pushes a trajectory into it, steps numbered from 0",
                   "  rcbctl replay jet run.npy --parts 8 --tolerance 0.1\n"
                   "  rcbctl replay jet step*.csv --parts 8 --tolerance inf --history jet.csv --replace",
                   kSceneGroup},
                  replay);
  add_scene_name(replays, replayed.name);
  add_value(
      replays, "FILES", replayed.files, kind::text("FILE..."),
      "one file per step, or a .npy of shape (steps, n, dims). Files that differ only in numbers and are given in "
      "alphabetical order, as a shell's * does, are taken in the order of the numbers: step.20 before step.100")
      ->required()
      ->expected(-1);
  add_value(replays, "--parts", replayed.parts, kind::part_count(),
            "number of parts (default: one for each of --part-sizes, else one per rank)");
  add_scene_options(replays, replayed.scene);
  add_value(replays, "--step-seconds", replayed.step_seconds, kind::number_from_zero("SECONDS"),
            std::string(kStepSecondsHelp) + "; the same at each step");
  add_column_options(replays, replayed.file);
  add_value(replays, "--history", replayed.history, kind::output_file(kind::Format::csv),
            "also write the step reports to this file");
}

}  // namespace rcb::cli
