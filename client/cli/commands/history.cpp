// history: the step reports, as a table, CSV, JSON or figure. They are fetched a page at a time and passed on at once,
// so that a long history takes no more memory than a short one.
#include <fmt/format.h>

#include "client/cli/app.hpp"
#include "client/cli/files/point_file.hpp"
#include "client/cli/print/curve.hpp"
#include "client/cli/print/output.hpp"
#include "client/cli/print/plot.hpp"
#include "client/cli/print/report_csv.hpp"
#include "common/io/files/output_file.hpp"

namespace rcb::cli {
namespace {

constexpr std::size_t kTableRows = 1000;  // aligned together

struct HistoryOptions {
  std::string name;
  client::HistoryRange range;
  std::string csv;
  std::string plot;
  std::vector<std::string> with;
};

// A form of output for the reports.
class Sink {
 public:
  Sink() = default;
  Sink(const Sink&) = delete;
  Sink& operator=(const Sink&) = delete;
  virtual ~Sink() = default;
  virtual Status take(const client::StepReport& report, const Json& json) = 0;
  virtual Status end() { return {}; }
};

// The items of a JSON array, which its maker closes.
class JsonArray final : public Sink {
 public:
  explicit JsonArray(const Context& context) : context_(context) {}
  Status take(const client::StepReport&, const Json& json) override {
    print_line((context_.document_begun ? "," : "[") + json.dump());
    context_.document_begun = true;
    return {};
  }

 private:
  const Context& context_;
};

class ForPeople final : public Sink {
 public:
  Status take(const client::StepReport&, const Json& report) override {
    table_.row({text_of(report, "step"), text_of(report, "epoch"), text_of(report, "error_before"),
                text_of(report, "error"), text_of(report, "imbalance"), text_of(report, "drifted"),
                text_of(report, "moved"), text_of(report, "migrated"), text_of(report, "way"),
                milliseconds(report.at("seconds").at("total").get<double>()),
                report.at("repartitioned").get<bool>() ? text_of(report, "reason") : ""});
    if (++rows_ % kTableRows == 0) table_.print();
    return {};
  }
  Status end() override {
    table_.print();
    return {};
  }

 private:
  Table table_{{{"step"},
                {"epoch"},
                {"error before"},
                {"error"},
                {"imbalance"},
                {"drifted"},
                {"moved"},
                {"migrated"},
                {"way", Table::Align::left},
                {"ms"},
                {"repartition", Table::Align::left}}};
  std::size_t rows_ = 0;
};

class CsvFile final : public Sink {
 public:
  explicit CsvFile(io::OutputFile file) : file_(std::move(file)) {}
  Status take(const client::StepReport&, const Json& report) override {
    text_ += report_csv_line(report);
    return text_.size() < kTextBytes ? Status() : write();
  }
  Status end() override {
    if (Status status = write(); !status) return status;
    return file_.commit();
  }

 private:
  static constexpr std::size_t kTextBytes = 1U << 16U;
  Status write() { return file_.write(std::exchange(text_, {})); }

  io::OutputFile file_;
  std::string text_ = reports_csv_header();
};

class Drawn final : public Sink {
 public:
  explicit Drawn(Curve& curve) : curve_(curve) {}
  Status take(const client::StepReport& report, const Json&) override {
    curve_.add(report);
    return {};
  }

 private:
  Curve& curve_;
};

using Sinks = std::vector<std::unique_ptr<Sink>>;

// Passes the reports to all sinks. Returns the number of steps.
Result<std::uint64_t> read(client::Client& client, const std::string& scene, const HistoryOptions& options,
                           const Sinks& sinks) {
  const auto take = [&](const client::StepReport& report) -> Status {
    const Json json = Json::parse(report.json);
    for (const auto& sink : sinks)
      if (Status status = sink->take(report, json); !status) return status;
    return reader_gone() ? Status(Code::aborted, "nobody reads on") : Status();
  };
  const auto found = client.history(scene, options.range, take);
  if (!found && !reader_gone()) return found.status();
  if (found && found->lost > 0)
    note(fmt::format("{} of {} reports are lost: {}", found->lost, found->lost + found->reports, found->loss));
  for (const auto& sink : sinks)
    if (Status status = sink->end(); !status) return status;
  return found ? found->reports : 0;
}

Result<Curve> curve_of(client::Client& client, const std::string& scene) {
  auto shown = ask(client, "scene.show", {{"scene", scene}});
  if (!shown) return shown.status();
  Curve curve;
  curve.name = scene;
  const Json& tolerance = shown->at("tolerance");
  if (tolerance.is_number()) curve.tolerance = tolerance.get<double>();
  return curve;
}

Status history(const HistoryOptions& options, const Context& context) {
  if (Status status = check_written_once({"--csv", options.csv}, {"--plot", options.plot}); !status) return status;
  auto client = connect(context);
  if (!client) return client.status();
  std::vector<Curve> curves;
  std::vector<std::string> scenes{options.name};
  if (!options.plot.empty()) {
    scenes.insert(scenes.end(), options.with.begin(), options.with.end());
    for (const std::string& scene : scenes) {
      auto curve = curve_of(*client, scene);
      if (!curve) return curve.status();
      curves.push_back(std::move(*curve));
    }
  }
  Sinks sinks;
  if (context.json)
    sinks.push_back(std::make_unique<JsonArray>(context));
  else if (options.csv.empty() && options.plot.empty())
    sinks.push_back(std::make_unique<ForPeople>());
  if (!options.csv.empty()) {
    auto file = io::OutputFile::create(options.csv);
    if (!file) return file.status();
    sinks.push_back(std::make_unique<CsvFile>(std::move(*file)));
  }
  if (!options.plot.empty()) sinks.push_back(std::make_unique<Drawn>(curves.front()));
  Progress progress("history " + options.name);
  const auto steps = read(*client, options.name, options, sinks);
  if (!steps) return steps.status();
  for (std::size_t k = 1; k < curves.size(); ++k) {
    Sinks other;
    other.push_back(std::make_unique<Drawn>(curves[k]));
    const auto drawn = read(*client, scenes[k], options, other);
    if (!drawn) return drawn.status();
  }
  if (!options.plot.empty()) progress.stage("drawing " + options.plot);
  if (!options.plot.empty())
    if (Status status = plot_history(options.plot, curves); !status) return status;
  progress.clear();
  // Last, since the document is whole only when everything else is done.
  if (context.json) print_line(context.document_begun ? "]" : "[]");
  for (const std::string& file : {options.csv, options.plot})
    if (!file.empty() && !context.json) print_line(fmt::format("{}: {} step{}", file, *steps, *steps == 1 ? "" : "s"));
  return {};
}

}  // namespace

void add_history_command(CLI::App& app, Context& context) {
  auto [command, options] =
      add_command(app, context,
                  {"history", "The report of every step (a rebalance by hand is no step)",
                   "  rcbctl history jet --last 20\n  rcbctl history jet --csv jet.csv --plot jet.svg\n"
                   "  rcbctl history static --with dynamic --plot both.svg",
                   kAskGroup},
                  history);
  add_scene_name(command, options.name);
  add_value(command, "--last", options.range.last, kind::whole_number("K", 0), "only so many, the newest");
  add_value(command, "--first", options.range.first, kind::whole_number("K", 0),
            "only so many, the oldest (of those that --last leaves)");
  add_value(command, "--csv", options.csv, kind::output_file(kind::Format::csv), "write them to this file");
  CLI::Option* plot = add_value(command, "--plot", options.plot, kind::output_file(kind::Format::figure),
                                "draw error against step, repartitions as red dots (SVG or PNG, by gnuplot)");
  add_value(command, "--with", options.with, kind::text("NAME"), "another scene in the same figure; may be repeated")
      ->allow_extra_args(false)
      ->needs(plot);
}

}  // namespace rcb::cli
