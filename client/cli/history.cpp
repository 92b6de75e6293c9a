// history: the step reports, as a table, CSV, JSON or figure.
#include <fmt/format.h>

#include "client/cli/app.hpp"
#include "client/cli/output.hpp"
#include "client/cli/plot.hpp"
#include "client/cli/report_csv.hpp"

namespace rcb::cli {
namespace {

struct Options {
  std::string name;
  std::optional<std::int64_t> last;
  std::string csv;
  std::string plot;
  std::vector<std::string> with;
};

Result<Json> reports_of(client::Client& client, const std::string& scene, std::optional<std::int64_t> last) {
  Json arguments{{"scene", scene}};
  if (last) arguments["last"] = *last;
  auto reply = ask(client, "history", arguments);
  if (!reply) return reply.status();
  return reply->at("history");
}

Result<Curve> curve_of(client::Client& client, const std::string& scene, Json reports) {
  auto shown = ask(client, "scene.show", {{"scene", scene}});
  if (!shown) return shown.status();
  const Json& tolerance = shown->at("tolerance");
  Curve curve{scene, std::nullopt, std::move(reports)};
  if (tolerance.is_number()) curve.tolerance = tolerance.get<double>();
  return curve;
}

Status plot(client::Client& client, const Options& options, const Json& reports) {
  std::vector<Curve> curves;
  auto own = curve_of(client, options.name, reports);
  if (!own) return own.status();
  curves.push_back(std::move(*own));
  for (const std::string& scene : options.with) {
    auto other = reports_of(client, scene, options.last);
    if (!other) return other.status();
    auto curve = curve_of(client, scene, std::move(*other));
    if (!curve) return curve.status();
    curves.push_back(std::move(*curve));
  }
  return plot_history(options.plot, curves);
}

void print_reports(const Json& reports) {
  Table table({{"step"},
               {"epoch"},
               {"error before"},
               {"error"},
               {"imbalance"},
               {"drifted"},
               {"moved"},
               {"migrated"},
               {"ms"},
               {"repartition", Table::Align::left}});
  for (const Json& report : reports)
    table.row({text_of(report, "step"), text_of(report, "epoch"), text_of(report, "error_before"),
               text_of(report, "error"), text_of(report, "imbalance"), text_of(report, "drifted"),
               text_of(report, "moved"), text_of(report, "migrated"),
               milliseconds(report.at("seconds").at("total").get<double>()),
               report.at("repartitioned").get<bool>() ? text_of(report, "reason") : ""});
  table.print();
}

Status history(const Options& options, const Context& context) {
  auto client = connect(context);
  if (!client) return client.status();
  auto reports = reports_of(*client, options.name, options.last);
  if (!reports) return reports.status();
  if (!options.csv.empty())
    if (Status status = write_reports_csv(options.csv, *reports); !status) return status;
  if (!options.plot.empty())
    if (Status status = plot(*client, options, *reports); !status) return status;
  if (context.json)
    print_json(*reports);
  else if (options.csv.empty() && options.plot.empty())
    print_reports(*reports);
  for (const std::string& file : {options.csv, options.plot})
    if (!file.empty() && !context.json) print_line(fmt::format("{}: {} steps", file, reports->size()));
  return {};
}

}  // namespace

void add_history_command(CLI::App& app, Context& context) {
  auto options = std::make_shared<Options>();
  CLI::App* command = add_command(app, context,
                                  {"history", "The report of every step",
                                   "  rcbctl history jet --last 20\n  rcbctl history jet --csv jet.csv --plot jet.svg\n"
                                   "  rcbctl history static --with dynamic --plot both.svg",
                                   kAskGroup},
                                  [options, &context] { return history(*options, context); });
  add_value(*command, "NAME", options->name, kind::text("NAME"), "the scene")->required();
  add_value(*command, "--last", options->last, kind::whole_number("K", 0), "only so many, the newest");
  add_value(*command, "--csv", options->csv, kind::output_file(kind::Format::csv), "write them to this file");
  CLI::Option* plot = add_value(*command, "--plot", options->plot, kind::output_file(kind::Format::svg),
                                "draw error against step, repartitions as red dots (SVG, by gnuplot)");
  add_value(*command, "--with", options->with, kind::text("NAME"), "another scene in the same figure; may be repeated")
      ->expected(1)
      ->needs(plot);
}

}  // namespace rcb::cli
