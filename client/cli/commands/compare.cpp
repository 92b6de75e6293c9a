// compare: the paper's Table 1 for a file: errors and costs of each partitioning method.
#include <algorithm>
#include <numeric>

#include <fmt/format.h>

#include "client/cli/app.hpp"
#include "client/cli/files/point_file.hpp"
#include "client/cli/print/output.hpp"
#include "client/cli/print/parts_table.hpp"
#include "common/io/files/output_file.hpp"
#include "common/wire/message.hpp"

namespace rcb::cli {
namespace {

struct CompareOptions {
  FileOptions file;
  int parts = 0;
  int ranks = 0;
  std::optional<double> ghost_width;
  std::string save;
  bool all = false;
};

std::string error_text(double error) { return fmt::format("{:.3g}", error); }

// A column for each method, a row for each part, as in the paper; below, the summary rows.
void print(const CompareOptions& options, const Json& result) {
  const Json& methods = result.at("methods");
  print_line(fmt::format("{}: {} points, {} parts; error of each part", options.file.path, text_of(result, "n"),
                         text_of(result, "parts")));
  print_line("");
  std::vector<Table::Column> columns{{"part", Table::Align::left}};
  for (const Json& method : methods) columns.push_back({text_of(method, "method")});
  Table table(std::move(columns));
  const auto parts = result.at("parts").get<std::size_t>();
  const auto add_row = [&](const std::string& title, auto&& cell) {
    std::vector<std::string> cells{title};
    for (const Json& method : methods) cells.push_back(cell(method));
    table.row(std::move(cells));
  };
  for (std::size_t p = 0; p < parts && !summarised(parts, options.all); ++p)
    add_row(std::to_string(p), [p](const Json& m) { return error_text(m.at("errors").at(p).get<double>()); });
  if (summarised(parts, options.all)) {
    const auto errors_of = [](const Json& m) { return m.at("errors").get<std::vector<double>>(); };
    add_row("least", [&](const Json& m) { return error_text(least_median_largest(errors_of(m))[0]); });
    add_row("median", [&](const Json& m) { return error_text(least_median_largest(errors_of(m))[1]); });
  }
  add_row("largest", [](const Json& m) { return error_text(m.at("error").get<double>()); });
  add_row("interface", [](const Json& m) { return text_of(m, "interface_area"); });
  add_row("ghosts", [](const Json& m) {
    const auto ghosts = m.at("ghosts").get<std::vector<std::uint64_t>>();
    return std::to_string(std::accumulate(ghosts.begin(), ghosts.end(), std::uint64_t{0}));
  });
  add_row("neighbours", [](const Json& m) {
    const auto list = m.at("neighbours").get<std::vector<std::int64_t>>();
    const double sum = static_cast<double>(std::accumulate(list.begin(), list.end(), std::int64_t{0}));
    return list.empty() ? std::string("-") : fmt::format("{:.3g}", sum / static_cast<double>(list.size()));
  });
  add_row("milliseconds", [](const Json& m) { return milliseconds(m.at("seconds").get<double>()); });
  table.print();
  print_line("");
  print_line(
      fmt::format("interface: common faces of the regions; ghosts: points of other parts within {} of a part's "
                  "box, all parts together; neighbours: mean over the parts; {} rank(s)",
                  text_of(result, "ghost_width"), text_of(result, "ranks")));
  if (summarised(parts, options.all)) print_line("--all has the error of each part");
}

Status compare(const CompareOptions& options, const Context& context) {
  if (Status status = check_not_overwritten("--save", options.save, {&options.file.path, 1}); !status) return status;
  auto session = Session::open(context, options.ranks);
  if (!session) return session.status();
  auto loaded = load_scene(*session, options.file, {{"parts", options.parts}, {"tolerance", "inf"}});
  if (!loaded) return loaded.status();
  Json arguments{{"scene", loaded->scene.name()}};
  if (options.ghost_width) arguments["ghost_width"] = *options.ghost_width;
  auto reply = ask(*session->client, "compare", arguments, kLongSeconds);
  if (!reply) return session->explain(reply.status());
  Json result{{"file", options.file.path}, {"ranks", session->client->ranks()}};
  for (const char* field : {"n", "parts", "ghost_width", "methods"}) result[field] = reply->at(field);
  if (!options.save.empty())
    if (Status status = io::write_file(options.save, wire::dump_json(result) + "\n"); !status) return status;
  note_empty_parts(result["n"].get<std::uint64_t>(), options.parts);
  return show(context, result, [&] { print(options, result); });
}

}  // namespace

void add_compare_command(CLI::App& app, Context& context) {
  auto [command, options] = add_command(
      app, context,
      {"compare", "Each way of dividing a file of points, side by side: RCB, bands, equal boxes, file order",
       "  rcbctl compare points.csv --parts 8\n"
       "  rcbctl compare run.npy --parts 8 --ghost-width 0.05 --json",
       kFileGroup},
      compare);
  add_file_options(command, options.file);
  add_value(command, "--parts", options.parts, kind::part_count(), "number of parts")->required();
  add_value(command, "--ranks", options.ranks, kind::rank_count(), kTemporaryRanksHelp);
  add_value(command, "--ghost-width", options.ghost_width, kind::number_from_zero("H"), kGhostWidthHelp);
  add_value(command, "--save", options.save, kind::output_file(kind::Format::json),
            "also write what --json prints to this file");
  command.add_flag("--all", options.all, kAllHelp);
}

}  // namespace rcb::cli
