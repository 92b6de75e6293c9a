// error, counts, stats, quality: numbers about a scene.
#include <cmath>
#include <numeric>

#include <fmt/format.h>

#include "client/cli/commands/near.hpp"
#include "client/cli/lists.hpp"
#include "client/cli/print/output.hpp"
#include "client/cli/print/parts_table.hpp"

namespace rcb::cli {
namespace {

struct ReadOptions {
  std::string name;
  bool all = false;
  std::optional<double> ghost_width;
  bool held = false;
  double deadline_seconds = kQuestionSeconds;
};

Status print_error(client::Client&, const ReadOptions&, const Json& reply) {
  Facts facts;
  for (const char* field : {"error", "tolerance", "imbalance", "step", "epoch"})
    facts.add(field, text_of(reply, field));
  facts.print();
  return {};
}

Status print_counts(client::Client&, const ReadOptions& options, const Json& reply) {
  const std::vector<double> counts = numbers(reply.at("counts"));
  const std::vector<double> targets = numbers(reply.at("targets"));
  const std::vector<double> loads = reply.contains("loads") ? numbers(reply["loads"]) : counts;
  std::vector<double> errors, badness;
  for (std::size_t p = 0; p < counts.size(); ++p) {
    errors.push_back(targets.at(p) > 0 ? (loads.at(p) - targets[p]) / targets[p] : std::nan(""));
    badness.push_back(std::isnan(errors.back()) ? 0 : std::fabs(errors.back()));
  }
  PartsTable table(counts.size());
  table.add("points", counts);
  if (reply.contains("loads")) table.add("load", loads);
  table.add("target", targets);
  table.add("error", errors, percent);
  table.print(badness, options.all);
  return {};
}

// "exchange 1, ids 20"
std::string tally_text(const Json& tally) {
  std::string text;
  for (const auto& [name, times] : tally.items()) text += (text.empty() ? "" : ", ") + name + " " + text_of(times);
  return text.empty() ? "-" : text;
}

std::string step_time_text(const Json& seconds, double steps) {
  if (steps == 0) return "-";
  std::string text;
  for (const auto& [name, value] : seconds.items())
    if (name != "total")
      text += fmt::format("{}{} {}", text.empty() ? "" : ", ", name, milliseconds(value.get<double>() / steps));
  return fmt::format("{} ms: {}", milliseconds(seconds.at("total").get<double>() / steps), text);
}

Status print_stats(client::Client& client, const ReadOptions& options, const Json& reply) {
  const auto shown = ask(client, "scene.show", {{"scene", options.name}});
  if (!shown) return shown.status();
  const auto status = ask(client, "status", Json::object());
  if (!status) return status.status();
  const auto steps = reply.at("steps").get<double>();
  Facts facts;
  facts.add("scene", fmt::format("{}: {} points in {}-D, {} parts by {}", options.name, text_of(*shown, "n"),
                                 text_of(*shown, "dims"), text_of(*shown, "parts"), text_of(*shown, "method")));
  facts.add("steps", fmt::format("{}, the last numbered {}; {} repartition{} by steps, epoch {}",
                                 text_of(reply, "steps"), text_of(*shown, "step"), text_of(reply, "repartitions"),
                                 reply.at("repartitions") == 1 ? "" : "s", text_of(*shown, "epoch")));
  facts.add("error", fmt::format("{} (tolerance {}), imbalance {}", text_of(*shown, "error"),
                                 text_of(*shown, "tolerance"), text_of(*shown, "imbalance")));
  facts.add("time a step", step_time_text(reply.at("seconds"), steps));
  facts.add("bytes a step", steps == 0 ? "-" : size(reply.at("bytes").get<double>() / steps));
  facts.add("points", fmt::format("{} drifted, {} moved, {} migrated", text_of(reply, "drifted"),
                                  text_of(reply, "moved"), text_of(reply, "migrated")));
  facts.add("work", fmt::format("{} scanned, {} searched; {} rounds, {} reductions", text_of(reply, "scanned"),
                                text_of(reply, "searched"), text_of(reply, "rounds"), text_of(reply, "reductions")));
  facts.add("skipped", tally_text(reply.at("skipped")));
  facts.add("asked", tally_text(reply.at("asked")));
  facts.add("open by", holders_text(*shown));
  facts.add("memory", memory_text(*status));
  facts.add("log", text_of(*status, "log"));
  facts.print();
  return {};
}

Status print_quality(client::Client&, const ReadOptions& options, const Json& reply) {
  const std::vector<double> ghosts = numbers(reply.at("ghosts"));
  PartsTable table(ghosts.size());
  table.add("neighbours", numbers(reply.at("neighbours")));
  table.add("ghosts", ghosts);
  const Json areas = reply.value("interface_areas", Json());
  if (areas.is_array()) table.add("interface", numbers(areas));
  table.print(ghosts, options.all);
  print_line("");
  print_line(fmt::format("all parts together: {} ghosts, interface {}; ghost width {}",
                         number(std::accumulate(ghosts.begin(), ghosts.end(), 0.0)), text_of(reply, "interface_area"),
                         text_of(reply, "ghost_width")));
  print_line(narrowest_text(reply));
  return {};
}

using Printer = Status (*)(client::Client&, const ReadOptions&, const Json&);

CLI::App* add_read(CLI::App& app, Context& context, const CommandText& text, std::shared_ptr<ReadOptions> options,
                   Printer print) {
  CLI::App* command = add_command(app, context, text, [options, &context, print, name = text.name]() -> Status {
    auto client = connect(context);
    if (!client) return client.status();
    Json arguments{{"scene", options->name}};
    if (options->held) arguments["held"] = true;
    if (options->ghost_width) arguments["ghost_width"] = *options->ghost_width;
    auto reply = ask(*client, name, arguments, options->deadline_seconds);
    if (!reply) return reply.status();
    if (!context.json) return print(*client, *options, *reply);
    print_json(*reply);
    return {};
  });
  add_scene_name(*command, options->name);
  return command;
}

}  // namespace

void add_read_commands(CLI::App& app, Context& context) {
  const auto options = std::make_shared<ReadOptions>();
  add_read(app, context,
           {"error", "The load-balance error: the largest abs(load - target) / target over the parts",
            "  rcbctl error jet", kAskGroup},
           options, print_error);
  CLI::App* counts = add_read(
      app, context, {"counts", "Points of each part, beside its target", "  rcbctl counts jet --json", kAskGroup},
      options, print_counts);
  counts->add_flag("--all", options->all, kAllHelp);
  add_read(
      app, context,
      {"stats", "A scene's totals: time, bytes, repartitions, and what was skipped", "  rcbctl stats jet", kAskGroup},
      options, print_stats);
  CLI::App* quality = add_read(app, context,
                               {"quality", "Interface area, neighbours and ghosts of each part",
                                "  rcbctl quality jet\n  rcbctl quality jet --ghost-width 0.05", kAskGroup},
                               options, print_quality);
  add_value(*quality, "--ghost-width", options->ghost_width, kind::number_from_zero("H"), kGhostWidthHelp);
  add_deadline(*quality, options->deadline_seconds);
  add_held(*quality, options->held);
  quality->add_flag("--all", options->all, kAllHelp);
}

}  // namespace rcb::cli
