// replay, stream: trajectories, a step a frame.
#include <utility>

#include <fmt/format.h>

#include "client/cli/app.hpp"
#include "client/cli/commands/feed.hpp"
#include "client/cli/files/frame_order.hpp"
#include "client/cli/files/point_file.hpp"
#include "client/cli/interrupt.hpp"
#include "client/cli/print/output.hpp"
#include "common/io/files/byte_source.hpp"
#include "common/wire/limits.hpp"

namespace rcb::cli {
namespace {

constexpr const char* kLammps = "lammpstrj";
constexpr const char* kXyz = "xyz";

struct ReplayOptions : FeedOptions {
  std::vector<std::string> files;
};

struct StreamOptions : FeedOptions {
  std::string format;                        // empty: by the first lines
  std::vector<const CLI::Option*> of_scene;  // those that a new scene is made with
};

class Replay {
 public:
  Replay(const ReplayOptions& options, const Context& context) : options_(options), feed_("replay", options, context) {}

  Status run() {
    Status status = feed_.begin(options_.files);
    if (!status) return status;
    const FrameOrder order = in_frame_order(options_.files);
    if (!order.changed.empty()) note(order.changed);
    for (std::size_t k = 0; k < order.files.size() && status; ++k) status = push_file(order.files[k], k + 1);
    return feed_.end(status);
  }

 private:
  // number: of the file, from 1.
  Status push_file(const std::string& path, std::size_t number) {
    FileOptions file = options_.file;
    file.path = path;
    if (options_.files.size() == 1) feed_.progress().stage("reading " + path);
    auto reader = io::open_trajectory(path, read_options(file));
    if (interrupted()) return feed_.stopped();
    if (!reader) return reader.status();
    for (std::uint64_t k = 0;; ++k) {
      auto points = (*reader)->next();
      if (interrupted()) return feed_.stopped();
      if (!points) return points.status();
      if (!*points) return check_end(**reader, path, k);
      if (!feed_.open() && (*points)->count == 0) {
        if ((*reader)->frames()) return no_points(path, options_.name);
        continue;  // a program may have written it before it made its first particle
      }
      if (!feed_.open())
        if (Status status = feed_.make_scene((*points)->dims); !status) return status;
      // Where there are several files, and each has one frame as far as is known, they are the steps.
      const std::uint64_t frames = (*reader)->frames().value_or(0);
      const std::uint64_t total = options_.files.size() == 1    ? frames
                                  : feed_.steps() + 1 == number ? options_.files.size()
                                                                : 0;
      const auto step = static_cast<std::int64_t>(feed_.steps());
      const std::string frame = fmt::format("{}, frame {} (step {})", path, k, step);
      if (Status status = feed_.push(**points, step, frame, total); !status) return status;
    }
  }

  // After the last of so many frames.
  Status check_end(const io::TrajectoryReader& reader, const std::string& path, std::uint64_t frames) const {
    const std::string unfinished = reader.unfinished();
    if (frames == 0 && !unfinished.empty()) return {Code::invalid_argument, unfinished, "was it written to its end?"};
    if (frames == 0) return {Code::invalid_argument, path + ": holds no frames", "save at least one step in it"};
    if (!feed_.open()) return no_points(path, options_.name);
    if (!unfinished.empty()) note(unfinished + "; the frames before it were pushed");
    return {};
  }

  const ReplayOptions& options_;
  Feed feed_;
};

Status replay(const ReplayOptions& options, const Context& context) { return Replay(options, context).run(); }

class Stream {
 public:
  Stream(const StreamOptions& options, const Context& context)
      : options_(options), file_(io::input_name(options.file.path)), feed_("stream", options, context) {}

  Status run() {
    if (Status status = feed_.begin({&options_.file.path, 1}); !status) return status;
    if (Status status = look_for_scene(); !status) return status;
    return feed_.end(push_frames());
  }

 private:
  // Before a program starts that would wait for its reader in vain.
  Status look_for_scene() {
    if (options_.scene.replace) return {};
    auto shown = ask(feed_.client(), "scene.show", {{"scene", options_.name}});
    if (shown.status().code() == Code::not_found) return {};
    if (!shown) return shown.status();
    for (const CLI::Option* option : options_.of_scene)
      if (option->count() > 0)
        return {Code::already_exists,
                fmt::format("scene '{}' exists already, and {} is for a new one", options_.name, option->get_name()),
                fmt::format("--replace makes it anew; without {} the stream goes on with it", option->get_name())};
    Status free =
        check_not_held(*shown, options_.name, "try again when it is closed, or give the stream a scene of its own");
    if (!free) return free;
    return feed_.go_on(*shown);
  }

  Status push_frames() {
    std::optional<io::FrameFormat> format;
    if (!options_.format.empty()) format = options_.format == kLammps ? io::FrameFormat::lammps : io::FrameFormat::xyz;
    feed_.progress().stage("waiting for " + file_);
    auto reader = io::open_frames(options_.file.path, read_options(options_.file), format);
    if (interrupted()) return feed_.stopped();
    if (!reader) return reader.status();
    for (std::uint64_t k = 0;; ++k) {
      auto points = (*reader)->next();
      if (interrupted()) return feed_.stopped();
      if (!points) return points.status();
      if (!*points) return check_end(**reader);
      if (!feed_.last_step() && (*points)->count == 0) continue;  // written before the first particle was made
      if (!feed_.open())
        if (Status status = feed_.make_scene((*points)->dims); !status) return status;
      const std::string frame =
          fmt::format("{}, frame {}{}", file_, k,
                      (*points)->timestep ? fmt::format(" (timestep {})", *(*points)->timestep) : std::string());
      if (Status status = feed_.push(**points, number_of(**points), frame, 0); !status) return status;
    }
  }

  // A step's number: the frame's timestep where there is one, as long as these rise. None: the last + 1.
  std::optional<std::int64_t> number_of(const io::Points& points) {
    const auto last = feed_.last_step();
    if (!points.timestep || *points.timestep < 0 || *points.timestep > wire::kStepMax) return std::nullopt;
    if (!last || *points.timestep > *last) return points.timestep;
    if (!std::exchange(told_, true))
      note(fmt::format("timestep {} comes behind step {}: such frames get the next numbers", *points.timestep, *last));
    return std::nullopt;
  }

  Status check_end(const io::TrajectoryReader& reader) const {
    const std::string unfinished = reader.unfinished();
    if (feed_.steps() > 0) {
      if (!unfinished.empty()) note(unfinished + "; the frames before it were pushed");
      return {};
    }
    if (!unfinished.empty()) return {Code::invalid_argument, unfinished, "was it written to its end?"};
    return {Code::invalid_argument, file_ + ": ended before a frame with particles came",
            "does the program that writes it dump there?"};
  }

  const StreamOptions& options_;
  const std::string file_;  // for messages
  Feed feed_;
  bool told_ = false;
};

Status stream(const StreamOptions& options, const Context& context) { return Stream(options, context).run(); }

}  // namespace

void add_replay_commands(CLI::App& app, Context& context) {
  auto [replays, replayed] =
      add_command(app, context,
                  {"replay", "Makes a scene and pushes a trajectory into it, steps numbered from 0",
                   "  rcbctl replay jet run.npy --parts 8 --tolerance 0.1\n"
                   "  rcbctl replay jet run.lammpstrj.gz --parts 8 --replace\n"
                   "  rcbctl replay jet step*.csv --parts 8 --tolerance inf --history jet.csv --replace",
                   kSceneGroup},
                  replay);
  add_scene_name(replays, replayed.name);
  add_value(
      replays, "FILES", replayed.files, kind::text("FILE..."),
      "LAMMPS dumps, XYZ files, a .npy of shape (steps, n, dims), or one file of any other format per step. Files that "
      "differ only in numbers and are given in alphabetical order, as a shell's * does, are taken in the order of the "
      "numbers: step.20 before step.100")
      ->required()
      ->expected(-1);
  add_feed_options(replays, replayed);

  auto [streams, streamed] =
      add_command(app, context,
                  {"stream", "Pushes a trajectory while another program writes it",
                   "  mkfifo run.fifo; rcbctl stream jet --parts 8 --format lammpstrj run.fifo &\n"
                   "  lmp -in in.jet     # which has: dump 1 all custom 100 run.fifo id x y z\n"
                   "  my_solver | rcbctl stream jet --format xyz - --replace",
                   kSceneGroup},
                  stream);
  add_scene_name(streams, streamed.name);
  add_value(streams, "FILE", streamed.file.path, kind::text("FILE"),
            "a FIFO, a file, or - for standard input; compressed by gzip or not. A step has the number of its frame's "
            "TIMESTEP or, without one, or where that doesn't rise, the last + 1. A scene that exists is gone on with, "
            "another is made")
      ->required();
  add_value(streams, "--format", streamed.format, kind::one_of("FORMAT", {kLammps, kXyz}),
            "lammpstrj (text dumps of LAMMPS and LIGGGHTS) or xyz (default: by the first lines)");
  streamed.of_scene = add_feed_options(streams, streamed);
}

}  // namespace rcb::cli
