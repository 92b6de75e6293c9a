// partition: partitions one file, once.
#include <algorithm>
#include <filesystem>
#include <system_error>
#include <utility>

#include <fmt/format.h>

#include "client/cli/app.hpp"
#include "client/cli/files/fetched.hpp"
#include "client/cli/files/part_files.hpp"
#include "client/cli/files/point_file.hpp"
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

// Writes the parts in the order of the file's rows; the service returns them in id order.
Status write_assignment(const PartitionOptions& options, Session& session, const std::string& scene) {
  auto answer = ask_arrays(*session.client, "assign", {{"scene", scene}}, kLongSeconds);
  if (!answer) return answer.status();
  const client::Array* array = answer->reply.find("part");
  if (array == nullptr) return {Code::protocol_error, "the answer to assign lacks its parts"};
  const auto part = array->i4();
  auto points = read_single(options.file);
  if (!points) return points.status();
  if (points->id.empty()) return io::write_npy(options.assign, part);
  if (points->id.size() != part.size())
    return {Code::aborted, options.file.path + " changed while it was partitioned", "run it again"};
  const std::vector<std::size_t> row = rows_by_id(*points);
  std::vector<std::int32_t> by_row(part.size());
  for (std::size_t k = 0; k < row.size(); ++k) by_row[row[k]] = part[k];
  return io::write_npy(options.assign, by_row);
}

Status write_parts(const PartitionOptions& options, Session& session, const std::string& scene) {
  if (session.embedded)
    return ask(*session.client, "write_parts", {{"scene", scene}, {"directory", absolute_path(options.out)}},
               kLongSeconds)
        .status();
  auto answer = ask_arrays(*session.client, "fetch", {{"scene", scene}}, kLongSeconds);
  if (!answer) return answer.status();
  auto set = fetched(answer->reply);
  if (!set) return set.status();
  if (Status status = make_directory(options.out); !status) return status;
  Json files = Json::array();
  return write_part_files(*set, options.parts, options.out, files);
}

Status write_outputs(const PartitionOptions& options, const LeftoverFiles& left, Session& session,
                     const std::string& scene) {
  if (!options.out.empty()) {
    if (Status status = write_parts(options, session, scene); !status) return status;
    if (Status status = left.remove(); !status) return status;
  }
  if (!options.assign.empty())
    if (Status status = write_assignment(options, session, scene); !status) return status;
  if (options.cuts.empty()) return {};
  auto cuts = ask_cuts(*session.client, scene);
  if (!cuts) return cuts.status();
  return io::write_file(options.cuts, cuts->dump() + "\n");
}

std::string per_part_text(const Json& values, bool all) {
  const auto numbers = values.get<std::vector<double>>();
  if (!summarised(numbers.size(), all)) return text_of(values);
  const auto [least, median, largest] = least_median_largest(numbers);
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
  for (const char* field : {"moved", "migrated"}) result[field] = report.at(field);
  result["seconds"] = {{"read", loaded.read_seconds},
                       {"partition", report.at("seconds").at("search")},
                       {"migrate", report.at("seconds").at("migrate")}};
  return result;
}

Status partition(const PartitionOptions& options, const Context& context) {
  if (Status status = check(options); !status) return status;
  LeftoverFiles left;
  if (!options.out.empty()) {
    auto found = LeftoverFiles::find(options.out, part_file_names(options.parts), options.replace);
    if (!found) return found.status();
    left = std::move(*found);
  }
  auto session = Session::open(context, options.ranks);
  if (!session) return session.status();
  const SteadyClock clock;
  const double start = clock.seconds();
  Json arguments{{"parts", options.parts}, {"method", options.method}, {"tolerance", "inf"}};
  if (!options.part_sizes.empty()) arguments["part_sizes"] = options.part_sizes;
  arguments["cut_tolerance"] = options.cut_tolerance;
  auto loaded = load_scene(*session, options.file, std::move(arguments));
  if (!loaded) return loaded.status();
  auto shown = ask(*session->client, "scene.show", {{"scene", loaded->scene.name()}});
  if (!shown) return session->explain(shown.status());
  const double before_write = clock.seconds();
  if (Status status = write_outputs(options, left, *session, loaded->scene.name()); !status)
    return session->explain(status);
  Json result = result_of(options, *session, *loaded, *shown);
  result["seconds"]["write"] = clock.seconds() - before_write;
  result["seconds"]["total"] = clock.seconds() - start;
  if (result["n"] == 0) note(options.file.path + ": holds no points");
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
  add_value(command, "--out", options.out, kind::text("DIR"), "a folder for one CSV per part");
  command.add_flag("--replace", options.replace, "remove the files of other parts from DIR");
  add_value(command, "--assign", options.assign, kind::output_file(kind::Format::npy),
            "the part of each point, int32, in input order");
  add_value(command, "--cuts", options.cuts, kind::output_file(kind::Format::json), "the cuts and regions");
  command.add_flag("--all", options.all, kAllHelp);
}

}  // namespace rcb::cli
