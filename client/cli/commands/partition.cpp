// partition: partitions one file, once.
#include <algorithm>
#include <filesystem>
#include <optional>
#include <system_error>
#include <utility>

#include <fmt/format.h>

#include "client/cli/app.hpp"
#include "client/cli/files/fetched.hpp"
#include "client/cli/files/new_files.hpp"
#include "client/cli/files/part_files.hpp"
#include "client/cli/files/point_file.hpp"
#include "client/cli/interrupt.hpp"
#include "client/cli/lists.hpp"
#include "client/cli/print/output.hpp"
#include "client/cli/print/parts_table.hpp"
#include "common/base/clock.hpp"
#include "common/files/paths.hpp"
#include "common/io/files/output_file.hpp"

namespace rcb::cli {
namespace {

struct PartitionOptions {
  FileOptions file;
  int parts = 0;
  std::string method = "rcb";
  int ranks = 0;
  std::vector<double> part_sizes;
  double cut_tolerance = 0;
  std::string out;
  std::string assign;
  std::string cuts;
  bool replace = false;
  bool all = false;
};

Status check(const PartitionOptions& options) {
  if (!options.part_sizes.empty() && options.part_sizes.size() != static_cast<std::size_t>(options.parts))
    return {Code::usage,
            fmt::format("--part-sizes has {} sizes for {} parts", options.part_sizes.size(), options.parts),
            "give one size a part, such as --parts 3 --part-sizes 1,2,3"};
  const std::pair assign("--assign", options.assign);
  const std::pair cuts("--cuts", options.cuts);
  if (Status status = check_written_once(assign, cuts); !status.ok()) return status;
  for (const auto& [option, path] : {assign, cuts})
    if (Status status = check_not_overwritten(option, path, {&options.file.path, 1}); !status) return status;
  std::error_code missing;
  const std::filesystem::path points = std::filesystem::canonical(options.file.path, missing);
  if (!options.out.empty() && !missing && std::filesystem::equivalent(points.parent_path(), options.out, missing) &&
      is_part_file_name(points.filename().string()))
    return {Code::usage, fmt::format("--out {} would overwrite or remove the points", options.out),
            "name another folder"};
  return {};
}

// Writes the parts in the order of the file's rows; the service returns them in ascending id.
Status write_assignment(const PartitionOptions& options, Session& session, const LoadedScene& loaded) {
  auto answer = ask_arrays(*session.client, "assign", {{"scene", loaded.scene.name()}}, kLongSeconds);
  if (!answer) return answer.status();
  const client::Array* part = answer->reply.find("part");
  if (part == nullptr) return {Code::protocol_error, "the answer to assign lacks its parts"};
  const auto rows = loaded.rows ? Result(*loaded.rows) : rows_of_ids(options.file, part->i4().size());
  if (!rows) return rows.status();
  if (rows->size() != part->i4().size()) return changed_meanwhile(options.file);
  std::vector<std::int32_t> by_row(rows->size());
  for (std::size_t k = 0; k < by_row.size(); ++k) by_row[(*rows)[k]] = part->i4()[k];
  return io::write_npy(options.assign, by_row);
}

// Writes the part files, into `folder`. The ranks write their own, unless the file has columns that they don't know.
Status write_parts(const PartitionOptions& options, Session& session, const std::string& scene,
                   const std::string& folder) {
  const auto further = io::read_further_columns(options.file.path, read_options(options.file));
  if (!further) return further.status();
  if (session.embedded && further->names.empty() && is_utf8(folder))
    return ask(*session.client, "write_parts", {{"scene", scene}, {"directory", absolute_path(folder)}}, kLongSeconds)
        .status();
  auto answer = ask_arrays(*session.client, "fetch", {{"scene", scene}}, kLongSeconds);
  if (!answer) return answer.status();
  auto set = fetched(answer->reply);
  if (!set) return set.status();
  Beside beside{further->names, {}};
  if (!beside.names.empty()) {
    const auto rows = rows_of_ids(options.file, further->rows());
    if (!rows) return rows.status();
    if (rows->size() != set->id.size()) return changed_meanwhile(options.file);
    for (const std::size_t row : *rows) beside.cells.push_back(further->row(row));
  }
  return write_part_files(*set, options.parts, folder, beside);
}

// All that is asked for, or nothing in the folder.
Status write_outputs(const PartitionOptions& options, const LeftoverFiles& left, std::optional<NewFiles>& files,
                     Session& session, const LoadedScene& loaded) {
  const std::string& scene = loaded.scene.name();
  if (!options.assign.empty())
    if (Status status = write_assignment(options, session, loaded); !status) return status;
  if (!options.cuts.empty()) {
    auto cuts = ask_cuts(*session.client, scene);
    if (!cuts) return cuts.status();
    if (Status status = io::write_file(options.cuts, cuts->dump() + "\n"); !status) return status;
  }
  if (!files) return {};
  if (Status status = write_parts(options, session, scene, files->hidden()); !status) return status;
  if (interrupted()) return interruption("");
  if (Status status = files->commit(part_file_names(options.parts)); !status) return status;
  return left.remove();
}

std::string per_part_text(const Json& values, bool all) {
  if (!summarised(values.size(), all)) return text_of(values);
  const auto [least, median, largest] = least_median_largest(numbers(values));
  return fmt::format("least {}, median {}, largest {}", number(least), number(median), number(largest));
}

void print(const PartitionOptions& options, const Json& result) {
  Facts facts;
  facts.add("file",
            fmt::format("{}, {} points in {}-D", options.file.path, text_of(result, "n"), text_of(result, "dims")));
  facts.add("partition", fmt::format("{} parts by {} on {} rank(s)", text_of(result, "parts"),
                                     text_of(result, "method"), text_of(result, "ranks")));
  facts.add("error", fmt::format("{}, imbalance {}", text_of(result, "error"), text_of(result, "imbalance")));
  facts.add("points a part", per_part_text(result.at("counts"), options.all));
  if (result.contains("loads")) facts.add("load a part", per_part_text(result["loads"], options.all));
  facts.add("hash", text_of(result, "hash"));
  const Json& seconds = result.at("seconds");
  std::string times;
  for (const auto& [name, value] : seconds.items())
    times += fmt::format("{}{} {}", times.empty() ? "" : ", ", name, milliseconds(value.get<double>()));
  facts.add("milliseconds", times);
  facts.print();
}

Json result_of(const PartitionOptions& options, const Session& session, const LoadedScene& loaded, const Json& shown) {
  const Json& report = loaded.report;
  Json result{{"n", shown.at("n")},
              {"dims", shown.at("dims")},
              {"parts", options.parts},
              {"ranks", session.client->ranks()},
              {"method", options.method},
              {"error", shown.at("error")},
              {"imbalance", shown.at("imbalance")},
              {"counts", shown.at("counts")}};
  if (shown.contains("loads") && shown["loads"].is_array()) result["loads"] = shown["loads"];
  for (const char* field : {"targets", "hash", "rounds", "reductions"}) result[field] = shown.at(field);
  if (shown.contains("weights_as_zero")) result["weights_as_zero"] = shown["weights_as_zero"];
  for (const char* field : {"moved", "migrated"}) result[field] = report.at(field);
  result["seconds"] = {{"read", loaded.read_seconds},
                       {"partition", report.at("seconds").at("search")},
                       {"migrate", report.at("seconds").at("migrate")}};
  return result;
}

void print_remarks(const PartitionOptions& options, const Json& result) {
  if (result["n"] == 0)
    note(options.file.path + ": holds no points");
  else
    note_empty_parts(result["n"].get<std::uint64_t>(), options.parts);
  note_lost_weights(result);
}

Status partition(const PartitionOptions& options, const Context& context) {
  if (Status status = check(options); !status) return status;
  LeftoverFiles left;
  std::optional<NewFiles> files;  // outlives the session: ranks that are stopped don't write into it any more
  if (!options.out.empty()) {
    auto found = LeftoverFiles::find(options.out, part_file_names(options.parts), options.replace);
    if (!found) return found.status();
    left = std::move(*found);
  }
  auto session = Session::open(context, options.ranks);
  if (interrupted()) return interruption(fmt::format("before {} was read; nothing was written", options.file.path));
  if (!session) return session.status();
  const SteadyClock clock;
  const double start = clock.seconds();
  Json arguments{{"parts", options.parts}, {"method", options.method}, {"tolerance", "inf"}};
  if (!options.part_sizes.empty()) arguments["part_sizes"] = options.part_sizes;
  arguments["cut_tolerance"] = options.cut_tolerance;
  auto loaded = load_scene(*session, options.file, std::move(arguments));
  if (interrupted()) return interruption(fmt::format("while {} was divided; nothing was written", options.file.path));
  if (!loaded) return loaded.status();
  auto shown = ask(*session->client, "scene.show", {{"scene", loaded->scene.name()}});
  if (!shown) return session->explain(shown.status());
  const double before_write = clock.seconds();
  if (!options.out.empty()) {
    auto begun = NewFiles::begin(options.out);
    if (!begun) return begun.status();
    files.emplace(std::move(*begun));
  }
  Progress progress(options.file.path);
  progress.stage("writing");
  const Status written = write_outputs(options, left, files, *session, *loaded);
  progress.clear();
  if (!written && interrupted())
    return interruption(files ? fmt::format("while the parts were written; {} is as it was", options.out)
                              : "while the results were written");
  if (!written) return session->explain(written);
  Json result = result_of(options, *session, *loaded, *shown);
  result["seconds"]["write"] = clock.seconds() - before_write;
  result["seconds"]["total"] = clock.seconds() - start;
  print_remarks(options, result);
  return show(context, result, [&] { print(options, result); });
}

}  // namespace

void add_partition_command(CLI::App& app, Context& context) {
  auto [command, options] = add_command(app, context,
                                        {"partition", "Partitions a file of points, once",
                                         "  rcbctl partition points.csv --parts 8 --out parts\n"
                                         "  rcbctl partition points.npy --parts 6 --ranks 4 --assign part.npy --json\n"
                                         "  rcbctl partition cloud.csv --parts 3 --part-sizes 1,2,3 --weights mass",
                                         kFileGroup},
                                        partition);
  add_file_options(command, options.file);
  add_value(command, "--parts", options.parts, kind::part_count(), "number of parts")->required();
  add_value(command, "--method", options.method, kind::method(), "rcb, bands-x, bands-y or bands-z")
      ->capture_default_str();
  add_value(command, "--ranks", options.ranks, kind::rank_count(), kTemporaryRanksHelp);
  add_list(command, "--part-sizes", options.part_sizes, kind::positive_number("LIST"), kPartSizesHelp);
  add_value(command, "--cut-tolerance", options.cut_tolerance, kind::number_between("E", 0, 1), kCutToleranceHelp)
      ->capture_default_str();
  add_value(command, "--out", options.out, kind::text("DIR"),
            "a folder for one CSV per part, with all columns of a text file");
  command.add_flag("--replace", options.replace, "remove the files of other parts from DIR");
  add_value(command, "--assign", options.assign, kind::output_file(kind::Format::npy),
            "the part of each of the file's rows, int32");
  add_value(command, "--cuts", options.cuts, kind::output_file(kind::Format::json), "the cuts and regions");
  command.add_flag("--all", options.all, kAllHelp);
}

}  // namespace rcb::cli
