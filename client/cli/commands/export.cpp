// export: writes a scene's particles as files for ParaView and scripts.
#include <algorithm>
#include <bit>
#include <cstdio>
#include <cstring>

#include <fmt/format.h>

#include "client/cli/app.hpp"
#include "client/cli/files/fetched.hpp"
#include "client/cli/files/new_files.hpp"
#include "client/cli/files/part_files.hpp"
#include "client/cli/interrupt.hpp"
#include "client/cli/print/output.hpp"
#include "common/files/paths.hpp"
#include "common/io/files/output_file.hpp"
#include "common/io/points.hpp"

namespace rcb::cli {
namespace {

struct ExportOptions {
  std::string name;
  std::string directory;
  std::vector<std::string> formats{"csv"};
  bool replace = false;
  bool held = false;
  double deadline_seconds = kQuestionSeconds;
};

// Legacy VTK is big-endian.
template <typename T>
void append_big(std::string& out, T value) {
  char bytes[sizeof(T)];
  std::memcpy(bytes, &value, sizeof(T));
  static_assert(std::endian::native == std::endian::little);
  out.append(std::make_reverse_iterator(bytes + sizeof(T)), std::make_reverse_iterator(bytes));
}

// Polydata with one vertex for each particle; part, id and weight (if any) for colouring.
std::string vtk_text(const Fetched& set, const std::string& scene) {
  const std::size_t n = set.id.size();
  std::string out =
      fmt::format("# vtk DataFile Version 3.0\nrcbd scene {}\nBINARY\nDATASET POLYDATA\nPOINTS {} double\n", scene, n);
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t a = 0; a < 3; ++a) append_big(out, a < set.axes.size() ? set.axes[a][i] : 0.0);
  out += fmt::format("\nVERTICES {} {}\n", n, 2 * n);
  for (std::size_t i = 0; i < n; ++i) {
    append_big(out, std::int32_t{1});
    append_big(out, static_cast<std::int32_t>(i));
  }
  out += fmt::format("\nPOINT_DATA {}\nSCALARS part int 1\nLOOKUP_TABLE default\n", n);
  for (const std::int32_t part : set.part) append_big(out, part);
  out += "\nSCALARS id vtktypeint64 1\nLOOKUP_TABLE default\n";  // VTK reads it into 64 bits on every system
  for (const std::int64_t id : set.id) append_big(out, id);
  if (set.weight) {
    out += "\nSCALARS weight double 1\nLOOKUP_TABLE default\n";
    for (const double weight : *set.weight) append_big(out, weight);
  }
  return out + "\n";
}

Status write_vtk(const Fetched& set, const ExportOptions& options, const std::string& folder) {
  if (set.id.size() > static_cast<std::size_t>(std::numeric_limits<std::int32_t>::max()))
    return {Code::too_large, "legacy VTK holds at most 2^31 - 1 points", "--format npy"};
  return io::write_file(join_path(folder, options.name + ".vtk"), vtk_text(set, options.name));
}

Status write_arrays(const Fetched& set, const std::string& folder) {
  const std::size_t dims = set.axes.size();
  std::vector<double> rows(set.id.size() * dims);
  for (std::size_t a = 0; a < dims; ++a)
    for (std::size_t i = 0; i < set.id.size(); ++i) rows[i * dims + a] = set.axes[a][i];
  const auto path = [&](const char* name) { return join_path(folder, name); };
  if (Status status = io::write_npy(path("positions.npy"), rows, {set.id.size(), dims}); !status) return status;
  if (Status status = io::write_npy(path("id.npy"), set.id); !status) return status;
  if (set.weight)
    if (Status status = io::write_npy(path("weight.npy"), *set.weight, {set.weight->size()}); !status) return status;
  return io::write_npy(path("part.npy"), set.part);
}

// Each once, however often it was named.
bool wants(const ExportOptions& options, const char* format) {
  return std::find(options.formats.begin(), options.formats.end(), format) != options.formats.end();
}

// The names of the files that an export writes.
std::vector<std::string> file_names(const ExportOptions& options, const Json& shown) {
  std::vector<std::string> names;
  if (wants(options, "csv"))
    for (std::string& name : part_file_names(shown.at("parts").get<int>())) names.push_back(std::move(name));
  if (wants(options, "npy")) {
    names.insert(names.end(), {"positions.npy", "id.npy"});
    if (shown.at("weights").get<bool>()) names.push_back("weight.npy");
    names.push_back("part.npy");
  }
  if (wants(options, "vtk")) names.push_back(options.name + ".vtk");
  return names;
}

// All of them, or none.
Status write_files(const Fetched& set, const ExportOptions& options, const Json& shown) {
  auto files = NewFiles::begin(options.directory);
  if (!files) return files.status();
  Status status;
  if (wants(options, "csv")) status = write_part_files(set, shown.at("parts").get<int>(), files->hidden());
  if (status && wants(options, "npy")) status = write_arrays(set, files->hidden());
  if (status && wants(options, "vtk")) status = write_vtk(set, options, files->hidden());
  if (status && interrupted()) status = interruption(fmt::format("while {} was written", options.directory));
  return status ? files->commit(file_names(options, shown)) : status;
}

// A scene, and its particles in the same parts.
struct Exported {
  Json shown;
  Answer particles;
  LeftoverFiles left;
};

Result<Exported> fetch_scene(client::Client& client, const ExportOptions& options) {
  constexpr int kTries = 10;
  for (int k = 0; k < kTries; ++k) {
    auto shown = ask(client, "scene.show", {{"scene", options.name}});
    if (!shown) return shown.status();
    auto left = LeftoverFiles::find(options.directory, file_names(options, *shown), options.replace);
    if (!left) return left.status();
    auto answer =
        ask_arrays(client, "fetch", {{"scene", options.name}, {"held", options.held}}, options.deadline_seconds);
    if (!answer) return answer.status();
    if (answer->json.at("epoch") == shown->at("epoch"))
      return Exported{std::move(*shown), std::move(*answer), std::move(*left)};
  }
  return Status(Code::aborted, fmt::format("the parts of scene '{}' changed while they were read", options.name),
                "ask again");
}

Status export_scene(const ExportOptions& options, const Context& context) {
  auto client = connect(context);
  if (!client) return client.status();
  auto exported = fetch_scene(*client, options);
  if (!exported) return exported.status();
  const auto& [shown, answer, left] = *exported;
  auto set = fetched(answer.reply);
  if (!set) return set.status();
  Progress progress("export " + options.name);
  progress.stage("writing");
  if (Status status = write_files(*set, options, shown); !status) return status;
  progress.clear();
  if (Status status = left.remove(); !status) return status;
  Json files = Json::array();
  for (const std::string& name : file_names(options, shown)) files.push_back(join_path(options.directory, name));
  return show(context,
              {{"scene", options.name},
               {"n", answer.json.at("n")},
               {"step", answer.json.at("positions_step")},  // an older name of the same
               {"positions_step", answer.json.at("positions_step")},
               {"epoch", answer.json.at("epoch")},
               {"files", files}},
              [&] {
                for (const Json& file : files) print_line(file.get<std::string>());
              });
}

}  // namespace

void add_export_command(CLI::App& app, Context& context) {
  auto [command, options] =
      add_command(app, context,
                  {"export", "Writes a scene's particles for ParaView and scripts",
                   "  rcbctl export jet out\n  rcbctl export jet out --format vtk,npy", kSceneGroup},
                  export_scene);
  add_scene_name(command, options.name);
  add_value(command, "DIR", options.directory, kind::text("DIR"), "made if missing")->required();
  add_list(command, "--format", options.formats, kind::one_of("LIST", {"csv", "npy", "vtk"}),
           "csv (part-0.csv, ...), npy (positions.npy, id.npy, part.npy, weight.npy), vtk (NAME.vtk); several with "
           "commas between")
      ->default_str("csv");
  add_deadline(command, options.deadline_seconds);
  add_held(command, options.held);
  command.add_flag("--replace", options.replace,
                   "remove the files of other parts from DIR, and overwrite arrays that no export wrote");
}

}  // namespace rcb::cli
