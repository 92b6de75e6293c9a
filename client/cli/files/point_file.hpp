// Room `files`: files of points as rcbctl reads and writes them.
//
// A point file as a scene: either read here and pushed, or read by the ranks of an embedded service.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <CLI/CLI.hpp>

#include "client/cli/app.hpp"
#include "common/files/descriptor.hpp"
#include "common/io/points.hpp"

namespace rcb::cli {

struct FileOptions {
  std::string path;
  int dims = 0;                      // 0: as the file says
  std::string weights;               // a column; empty: none
  std::vector<std::string> columns;  // of the positions; empty: as the file says
  std::string ids;                   // likewise
};

inline constexpr const char* kDimsHelp =
    "1, 2 or 3 dimensions (default: as many as there are columns named x, y, z, or else columns)";
inline constexpr const char* kWeightsHelp = "the column of weights, by name or by number, counted from 0";
inline constexpr const char* kColumnsHelp =
    "the columns of positions, by name or by number, with commas between (default: those named x, y, z)";
inline constexpr const char* kIdsHelp = "the column of ids (default: the one named id; else rows are counted)";

// Adds --dims, --columns, --ids and --weights.
void add_column_options(CLI::App& command, FileOptions& options);
// The same after FILE, whose option it returns.
CLI::Option* add_file_options(CLI::App& command, FileOptions& options);

// What io must know to read it. Ctrl-C ends the reading.
io::ReadOptions read_options(const FileOptions& options);
// The only frame of a point file or trajectory. Errors: those of io; invalid_argument if there are more frames;
// interrupted.
Result<io::Points> read_single(const FileOptions& options);
// Refuses an option whose file is one of those that are read.
Status check_not_overwritten(const char* option, const std::string& written, std::span<const std::string> read);
// Refuses two options, given with the files that they write, if both write one.
Status check_written_once(const std::pair<const char*, std::string>& one,
                          const std::pair<const char*, std::string>& other);
// The rows in ascending order of their ids; all as they are, where there are none.
std::vector<std::size_t> rows_by_id(const io::Points& points);
// Row numbers of a file whose points the service has, in ascending order of their ids; `count`: how many it has. Errors
// also: aborted, if the file has another number.
Result<std::vector<std::size_t>> rows_of_ids(const FileOptions& options, std::size_t count);
Status changed_meanwhile(const FileOptions& options);

// Remarks on stderr. The first: where there are more parts than particles, so that some have none.
void note_empty_parts(std::uint64_t particles, int parts);
// report: of a step or scene. If some weights are so small beside the greatest that they count as 0.
void note_lost_weights(const Json& report);
client::Positions positions_of(const io::Points& points);
// "FILE" or "FILE.h5:/path", absolute.
std::string absolute_path(const std::string& path);

// A scene with a unique name, dropped with this object, or when this program dies.
class TemporaryScene {
 public:
  // arguments: those of scene.create except the name. The session must outlive this object.
  static Result<TemporaryScene> create(Session& session, Json arguments);
  TemporaryScene(TemporaryScene&&) = default;
  TemporaryScene& operator=(TemporaryScene&&) = delete;
  ~TemporaryScene();
  const std::string& name() const { return name_; }

 private:
  TemporaryScene() = default;

  client::Client* client_ = nullptr;
  std::string name_;
  Descriptor lifeline_;  // to the janitor, the process that drops the scene if this one dies; none: embedded, or moved
  int janitor_ = -1;
};

struct LoadedScene {
  TemporaryScene scene;
  Json report;              // of its first step
  double read_seconds = 0;  // until the points were in memory, in the ranks or here
  // Of a file that can be read only once: its rows in ascending order of their ids.
  std::optional<std::vector<std::size_t>> rows;
};

// Loads the file as a scene of `session`. scene_arguments: those of scene.create except name and dims.
Result<LoadedScene> load_scene(Session& session, const FileOptions& options, Json scene_arguments);

}  // namespace rcb::cli
