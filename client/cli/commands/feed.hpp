// What `replay` and `stream` share: a scene into which the frames of a trajectory are pushed, a step a frame.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "client/cli/app.hpp"
#include "client/cli/files/frame_pusher.hpp"
#include "client/cli/files/point_file.hpp"
#include "client/cli/print/output.hpp"
#include "common/base/clock.hpp"
#include "common/io/files/output_file.hpp"

namespace rcb::cli {

struct FeedOptions {
  std::string name;
  FileOptions file;  // the columns of each frame
  std::optional<int> parts;
  client::SceneOptions scene;  // but for its parts and dims
  std::optional<double> step_seconds;
  std::string history;
};

// Returns those that a scene is made with.
std::vector<const CLI::Option*> add_feed_options(CLI::App& command, FeedOptions& options);

// The table of --history, written as the reports come; it appears under its name at the end.
class HistoryFile {
 public:
  Status open(const std::string& path);
  Status add(const Json& report);
  Status close() { return file_ ? file_->commit() : Status(); }
  const std::string& path() const { return path_; }

 private:
  std::optional<io::OutputFile> file_;
  std::string path_;
};

// Pushes frames into a scene and sums up what the service reports.
class Feed {
 public:
  // The options must outlive it.
  Feed(const char* command, const FeedOptions& options, const Context& context);

  // files: those that will be read, which are not to be overwritten.
  Status begin(std::span<const std::string> files);
  // Then one of these, before the first push: a new scene, or one that exists; shown: as `scene.show` describes it.
  Status make_scene(int dims);
  Status go_on(const Json& shown);
  // number: the step's; none: the last + 1. frame: for messages. total: of the steps, 0 if it isn't known.
  Status push(const io::Points& points, std::optional<std::int64_t> number, const std::string& frame,
              std::uint64_t total);
  // The failure of a command that was interrupted between two steps.
  Status stopped() const;
  // status: how it ended. The steps before a bad frame, or before Ctrl-C, are committed, so their history stays, too.
  Status end(const Status& status);

  client::Client& client() { return *client_; }
  Progress& progress() { return progress_; }
  std::uint64_t steps() const { return steps_; }
  bool open() const { return pusher_.has_value(); }
  std::optional<std::int64_t> last_step() const { return pusher_ ? pusher_->last_step() : std::nullopt; }

 private:
  Result<std::vector<std::int64_t>> ask_ids();
  Status add(const client::StepReport& report);
  Status show_end() const;

  const FeedOptions& options_;
  const Context& context_;
  SteadyClock clock_;
  double start_ = 0;
  Progress progress_;
  HistoryFile history_;
  std::optional<client::Client> client_;
  std::optional<FramePusher> pusher_;
  std::uint64_t steps_ = 0;
  std::uint64_t repartitions_ = 0;
  double error_sum_ = 0;
  double error_max_ = 0;
  int parts_ = 0;
  Json tolerance_;
  std::string policy_;
  Json last_;  // report
};

}  // namespace rcb::cli
