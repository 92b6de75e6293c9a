#include "client/cli/commands/feed.hpp"

#include <algorithm>
#include <numeric>

#include <fmt/format.h>

#include "client/cli/files/fetched.hpp"
#include "client/cli/interrupt.hpp"
#include "client/cli/print/report_csv.hpp"

namespace rcb::cli {

std::vector<const CLI::Option*> add_feed_options(CLI::App& command, FeedOptions& options) {
  const std::size_t before = command.get_options().size();
  add_value(command, "--parts", options.parts, kind::part_count(),
            "number of parts (default: one for each of --part-sizes, else one per rank)");
  add_scene_options(command, options.scene);
  const std::vector<CLI::Option*> all = command.get_options();
  const std::vector<const CLI::Option*> of_scene(all.begin() + static_cast<std::ptrdiff_t>(before), all.end());
  add_value(command, "--step-seconds", options.step_seconds, kind::number_from_zero("SECONDS"),
            std::string(kStepSecondsHelp) + "; the same at each step");
  add_column_options(command, options.file);
  add_value(command, "--history", options.history, kind::output_file(kind::Format::csv),
            "also write the step reports to this file");
  return of_scene;
}

Status HistoryFile::open(const std::string& path) {
  if (path.empty()) return {};
  auto file = io::OutputFile::create(path);
  if (!file) return file.status();
  file_.emplace(std::move(*file));
  path_ = path;
  return file_->write(reports_csv_header());
}

Status HistoryFile::add(const Json& report) { return file_ ? file_->write(report_csv_line(report)) : Status(); }

Feed::Feed(const char* command, const FeedOptions& options, const Context& context)
    : options_(options), context_(context), progress_(fmt::format("{} {}", command, options.name)) {}

Status Feed::begin(std::span<const std::string> files) {
  if (Status status = check_not_overwritten("--history", options_.history, files); !status) return status;
  auto client = connect_persistent(context_);
  if (!client) return client.status();
  client_.emplace(std::move(*client));
  start_ = clock_.seconds();
  return history_.open(options_.history);
}

Status Feed::make_scene(int dims) {
  client::SceneOptions scene = options_.scene;
  const int parts = scene.part_sizes.empty() ? client_->ranks() : static_cast<int>(scene.part_sizes.size());
  scene.parts = options_.parts.value_or(parts);
  scene.dims = dims;
  if (Status status = client_->create_scene(options_.name, scene); !status) return status;
  tolerance_ = tolerance_json(scene.tolerance);
  policy_ = scene.policy;
  auto opened = client_->open_scene(options_.name);
  if (!opened) return opened.status();
  pusher_.emplace(std::move(*opened), std::vector<std::int64_t>());
  return {};
}

Status Feed::go_on(const Json& shown) {
  tolerance_ = shown.at("tolerance");
  policy_ = shown.at("policy").get<std::string>();
  std::vector<std::int64_t> ids(shown.at("n").get<std::size_t>());
  std::iota(ids.begin(), ids.end(), 0);
  if (shown.at("ids").get<bool>()) {
    auto asked = ask_ids();
    if (!asked) return asked.status();
    ids = std::move(*asked);
  }
  auto opened = client_->open_scene(options_.name);
  if (!opened) return opened.status();
  pusher_.emplace(std::move(*opened), std::move(ids));
  return {};
}

Result<std::vector<std::int64_t>> Feed::ask_ids() {
  auto answer = ask_arrays(*client_, "fetch", {{"scene", options_.name}}, kLongSeconds);
  if (!answer) return answer.status();
  const auto set = fetched(answer->reply);
  if (!set) return set.status();
  return std::vector<std::int64_t>(set->id.begin(), set->id.end());
}

Status Feed::push(const io::Points& points, std::optional<std::int64_t> number, const std::string& frame,
                  std::uint64_t total) {
  client::StepOptions step;
  step.step = number;
  step.step_seconds = options_.step_seconds;
  auto result = pusher_->push(points, step);
  if (result.status().code() == Code::interrupted)
    return interruption(
        fmt::format("during the step of {}, which the service may still do; the {} before it stand", frame, steps_));
  if (!result)
    return {result.status().code(), fmt::format("{}: {}", frame, result.status().message()), result.status().hint()};
  if (Status status = add(result->report); !status) return status;
  progress_.at(steps_, total, "error " + cli::number(result->report.error));
  return {};
}

Status Feed::stopped() const {
  return interruption(fmt::format("after {} step{}{}", steps_, steps_ == 1 ? "" : "s",
                                  steps_ == 0 ? "" : fmt::format(", which stand in scene '{}'", options_.name)));
}

Status Feed::end(const Status& status) {
  progress_.clear();
  if (steps_ > 0) {
    if (Status written = history_.close(); !written) return written;
    if (!status && !history_.path().empty())
      note(fmt::format("{} has the reports of the {} steps before", history_.path(), steps_));
    if (!status && status.code() != Code::interrupted)
      note(fmt::format("the {} steps before stand in scene '{}'", steps_, options_.name));
  }
  if (!status) return status;
  note_empty_parts(last_.at("n").get<std::uint64_t>(), parts_);
  note_lost_weights(last_);
  return show_end();
}

Status Feed::add(const client::StepReport& report) {
  ++steps_;
  last_ = Json::parse(report.json);
  parts_ = report.parts;
  if (report.repartitioned && report.error_before) ++repartitions_;
  const double error = report.error_before.value_or(report.error);
  error_sum_ += error;
  error_max_ = std::max(error_max_, error);
  return history_.add(last_);
}

Status Feed::show_end() const {
  const double mean = steps_ == 0 ? 0 : error_sum_ / static_cast<double>(steps_);
  const double seconds = clock_.seconds() - start_;
  return show(context_,
              {{"scene", options_.name},
               {"steps", steps_},
               {"parts", parts_},
               {"tolerance", tolerance_},
               {"policy", policy_},
               {"repartitions", repartitions_},
               {"error_mean", mean},
               {"error_max", error_max_},
               {"seconds", seconds},
               {"last", last_}},
              [&] {
                Facts facts;
                facts.add("scene",
                          fmt::format("{}, {} parts, tolerance {}", options_.name, parts_, text_of(tolerance_)));
                facts.add("steps", std::to_string(steps_));
                facts.add("repartitions", fmt::format("{} after the first partition", repartitions_));
                facts.add("error", fmt::format("mean {}, largest {} (as found when a step arrived)", cli::number(mean),
                                               cli::number(error_max_)));
                facts.add("time", fmt::format("{:.3g} s", seconds));
                facts.print();
              });
}

}  // namespace rcb::cli
