#include "client/cli/files/point_file.hpp"

#include <algorithm>
#include <filesystem>
#include <numeric>
#include <random>

#include <fcntl.h>
#include <fmt/format.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include "client/cli/interrupt.hpp"
#include "client/cli/print/output.hpp"
#include "common/base/clock.hpp"
#include "common/io/files/byte_source.hpp"

namespace rcb::cli {
namespace {

constexpr int kDropTriesMax = 600;
constexpr int kProbeSlices = 4096;
constexpr int kDimsDefault = 3;
constexpr double kSilenceSeconds = 5;  // until it is told that a FIFO or standard input gives nothing

std::string unique_name() {
  std::random_device random;
  return fmt::format("rcbctl-{}-{:08x}{:08x}", getpid(), random(), random());
}

// Runs in a process that waits for the end of this one and then drops the scene.
[[noreturn]] void run_janitor(const std::string& endpoint, const std::string& scene, int lifeline_fd) {
  setsid();
  signal(SIGINT, SIG_IGN);
  signal(SIGTERM, SIG_IGN);
  const int pipe_fd = dup2(lifeline_fd, 0);
  const int null_fd = open("/dev/null", O_WRONLY);
  dup2(null_fd, 1);
  dup2(null_fd, 2);
  close_range(3, ~0U, 0);
  char byte = 0;
  if (::read(pipe_fd, &byte, 1) > 0) _exit(0);
  // The service may take a moment to notice that the scene's client has gone.
  for (int i = 0; i < kDropTriesMax; ++i) {
    auto client = launch::reach(endpoint, "rcbctl", 2);
    if (!client) break;
    const Status status = client->drop_scene(scene);
    if (status || status.code() == Code::not_found) break;
    usleep(200'000);
  }
  _exit(0);
}

// Whether all of it can be named in JSON.
bool all_utf8(const FileOptions& options) {
  return is_utf8(options.path) && is_utf8(options.weights) && is_utf8(options.ids) &&
         std::ranges::all_of(options.columns, [](const std::string& column) { return is_utf8(column); });
}

// The dims of a file that ranks can read in slices, from its first rows.
Result<int> sliceable_dims(const FileOptions& options) {
  auto slice = io::read_points_slice(options.path, read_options(options), 0, kProbeSlices);
  if (!slice) return slice.status();
  return slice->dims > 0 ? slice->dims : kDimsDefault;
}

// Points that this program has read, as the scene's first step.
Result<LoadedScene> push_points(Session& session, TemporaryScene scene, const io::Points& points, double read_seconds) {
  auto open = session.client->open_scene(scene.name());
  if (!open) return open.status();
  client::StepOptions step;
  step.ids = points.id;
  step.weights = points.weight;
  step.deadline_seconds = kLongSeconds;
  auto result = open->step(positions_of(points), step);
  if (!result) return result.status();
  return LoadedScene{std::move(scene), Json::parse(result->report.json), read_seconds, {}};
}

// Every rank of the service reads its own slice of the file.
Result<LoadedScene> load_in_ranks(Session& session, const FileOptions& options, int dims, Json scene_arguments) {
  scene_arguments["dims"] = dims;
  auto scene = TemporaryScene::create(session, std::move(scene_arguments));
  if (!scene) return scene.status();
  Json arguments{{"scene", scene->name()}, {"path", absolute_path(options.path)}};
  if (options.dims > 0) arguments["dims"] = options.dims;
  if (!options.weights.empty()) arguments["weights"] = options.weights;
  if (!options.columns.empty()) arguments["columns"] = options.columns;
  if (!options.ids.empty()) arguments["ids"] = options.ids;
  Progress progress(options.path);
  progress.stage("the ranks read and divide it");
  auto reply = ask(*session.client, "load", arguments, kLongSeconds);
  if (!reply) {
    // The service doesn't quote the file's content in messages; this program may, since its user can read the file.
    const Code code = reply.status().code();
    if (code != Code::invalid_argument && code != Code::not_finite) return session.explain(reply.status());
    const auto own = read_single(options);
    if (!own) return own.status();
    // Ranks don't load a file without points; here it has an answer.
    return own->count == 0 ? push_points(session, std::move(*scene), *own, 0) : session.explain(reply.status());
  }
  Json report = reply->at("report");
  const double read_seconds = report.at("seconds").at("receive").get<double>();
  return LoadedScene{std::move(*scene), std::move(report), read_seconds, {}};
}

}  // namespace

void add_column_options(CLI::App& command, FileOptions& options) {
  add_value(command, "--dims", options.dims, kind::dimensions(), kDimsHelp);
  add_list(command, "--columns", options.columns, kind::text("COLUMNS"), kColumnsHelp);
  add_value(command, "--ids", options.ids, kind::text("COLUMN"), kIdsHelp);
  add_value(command, "--weights", options.weights, kind::text("COLUMN"), kWeightsHelp);
}

CLI::Option* add_file_options(CLI::App& command, FileOptions& options) {
  CLI::Option* file =
      add_value(command, "FILE", options.path, kind::text("FILE"),
                "CSV or text, .xyz, a LAMMPS dump, these also as .gz; .npy; FILE.h5:/path; - for standard "
                "input. A column named id is taken as ids");
  add_column_options(command, options);
  return file->required();
}

std::string absolute_path(const std::string& path) { return std::filesystem::absolute(path).string(); }

io::ReadOptions read_options(const FileOptions& options) {
  const auto on_wait = [path = io::input_name(options.path), told = false](double seconds) mutable {
    Progress::tick();
    if (seconds > kSilenceSeconds && !std::exchange(told, true)) note(path + ": waiting for who writes it");
  };
  return {.dims = options.dims,
          .weights = options.weights,
          .columns = options.columns,
          .ids = options.ids,
          .stop = &interrupt_flag(),
          .on_wait = on_wait};
}

Result<io::Points> read_single(const FileOptions& options) {
  auto reader = io::open_trajectory(options.path, read_options(options));
  if (interrupted()) return interruption(fmt::format("while {} was read", options.path));
  if (!reader) return reader.status();
  const auto several = [&options](const std::string& frames) {
    return Status(Code::invalid_argument,
                  fmt::format("{}: holds {} frames, one is wanted", io::input_name(options.path), frames),
                  "rcbctl replay pushes a trajectory");
  };
  if (const auto frames = (*reader)->frames(); frames && *frames != 1) return several(std::to_string(*frames));
  auto only = (*reader)->next();
  if (!only) return only.status();
  if (!*only) return Status(Code::invalid_argument, (*reader)->unfinished(), "was it written to its end?");
  const auto second = (*reader)->next();
  if (interrupted()) return interruption(fmt::format("while {} was read", options.path));
  if (!second) return second.status();
  if (*second || !(*reader)->unfinished().empty()) return several("several");
  return std::move(**only);
}

Status check_not_overwritten(const char* option, const std::string& written, std::span<const std::string> read) {
  std::error_code missing;
  for (const std::string& points : read)
    if (!written.empty() && std::filesystem::equivalent(written, points, missing))
      return {Code::usage, fmt::format("{} {} would overwrite the points", option, written), "give it another name"};
  return {};
}

Status check_written_once(const std::pair<const char*, std::string>& one,
                          const std::pair<const char*, std::string>& other) {
  std::error_code unknown;
  const auto place = [&unknown](const std::string& path) {
    return std::filesystem::weakly_canonical(std::filesystem::absolute(path, unknown), unknown);
  };
  if (one.second.empty() || other.second.empty() || place(one.second) != place(other.second)) return {};
  return {Code::usage, fmt::format("{} and {} would write one file, {}", one.first, other.first, one.second),
          "give them two names"};
}

std::vector<std::size_t> rows_by_id(const io::Points& points) {
  std::vector<std::size_t> rows(points.count);
  std::iota(rows.begin(), rows.end(), std::size_t{0});
  if (!points.id.empty()) std::ranges::sort(rows, {}, [&](std::size_t row) { return points.id[row]; });
  return rows;
}

Status changed_meanwhile(const FileOptions& options) {
  return {Code::aborted, options.path + " changed while it was read", "run it again"};
}

Result<std::vector<std::size_t>> rows_of_ids(const FileOptions& options, std::size_t count) {
  const auto points = read_single(options);
  if (!points) return points.status();
  if (points->count != count) return changed_meanwhile(options);
  return rows_by_id(*points);
}

void note_empty_parts(std::uint64_t particles, int parts) {
  if (particles < static_cast<std::uint64_t>(parts))
    note(fmt::format("{} parts for {} point{}: some parts are empty", parts, particles, particles == 1 ? "" : "s"));
}

void note_lost_weights(const Json& report) {
  if (const auto lost = report.find("weights_as_zero"); lost != report.end())
    note(fmt::format("{} of the weights above 0 {} so small beside the greatest that {} 0", text_of(*lost),
                     *lost == 1 ? "is" : "are", *lost == 1 ? "it counts as" : "they count as"));
}

client::Positions positions_of(const io::Points& points) {
  client::Positions positions;
  positions.count = points.count;
  positions.dims = points.dims;
  for (std::size_t a = 0; a < points.position.size(); ++a) positions.axis[a] = points.position[a].data();
  return positions;
}

Result<TemporaryScene> TemporaryScene::create(Session& session, Json arguments) {
  TemporaryScene scene;
  scene.name_ = unique_name();
  arguments["scene"] = scene.name_;
  if (!session.embedded) {
    int lifeline[2];
    if (pipe2(lifeline, O_CLOEXEC) != 0) return Status(Code::io_error, "no pipe can be made");
    std::fflush(nullptr);
    const std::string endpoint = session.client->endpoint();
    const pid_t child = fork();
    if (child == 0) {
      close(lifeline[1]);
      run_janitor(endpoint, scene.name_, lifeline[0]);
    }
    close(lifeline[0]);
    scene.lifeline_ = Descriptor(lifeline[1]);
    scene.janitor_ = child;
    if (child < 0) return Status(Code::io_error, "no process can be started");
  }
  auto reply = ask(*session.client, "scene.create", arguments);
  if (!reply) return reply.status();
  scene.client_ = &*session.client;
  return scene;
}

TemporaryScene::~TemporaryScene() {
  // An embedded service ends with all its scenes.
  if (!lifeline_.open()) return;
  const char done = 'd';
  const bool dropped = client_ == nullptr || (!interrupted() && client_->drop_scene(name_).ok());
  // Otherwise the janitor tries on a connection of its own. After Ctrl-C nobody waits for that.
  if (dropped && write(lifeline_.get(), &done, 1) != 1) note("the process that watches the temporary scene has gone");
  lifeline_.close();
  if (janitor_ > 0 && (dropped || !interrupted())) waitpid(janitor_, nullptr, 0);
}

Result<LoadedScene> load_scene(Session& session, const FileOptions& options, Json scene_arguments) {
  const SteadyClock clock;
  const double start = clock.seconds();
  if (session.embedded && !io::is_stream(options.path) && all_utf8(options)) {
    // A file that can't be sliced, such as a trajectory of one frame, or can't be read at all, is read by this program.
    const auto dims = sliceable_dims(options);
    if (dims) return load_in_ranks(session, options, *dims, std::move(scene_arguments));
  }
  Progress progress(options.path);
  progress.stage("reading");
  auto points = read_single(options);
  if (!points) return points.status();
  const double read_seconds = clock.seconds() - start;
  progress.stage("dividing");
  scene_arguments["dims"] = points->dims > 0 ? points->dims : kDimsDefault;
  auto scene = TemporaryScene::create(session, std::move(scene_arguments));
  if (!scene) return scene.status();
  auto loaded = push_points(session, std::move(*scene), *points, read_seconds);
  if (loaded && io::is_stream(options.path)) loaded->rows = rows_by_id(*points);
  return loaded;
}

}  // namespace rcb::cli
