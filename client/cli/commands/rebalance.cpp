// rebalance: repartitions now, or tells what that would change.

#include <fmt/format.h>

#include "client/cli/app.hpp"
#include "client/cli/print/output.hpp"

namespace rcb::cli {
namespace {

struct RebalanceOptions {
  std::string name;
  std::optional<std::string> method;
  std::optional<int> parts;
  std::optional<double> tolerance;
  bool dry_run = false;
  bool force = false;
  bool held = false;
  double deadline_seconds = kQuestionSeconds;
};

void print(const Json& reply, bool dry_run) {
  Facts facts;
  facts.add("scene", text_of(reply, "scene"));
  facts.add("partition", fmt::format("{}, {} parts", text_of(reply, "method"), text_of(reply, "parts")));
  facts.add("error", fmt::format("{} -> {}", text_of(reply, "error_before"), text_of(reply, "error")));
  facts.add(dry_run ? "would move" : "moved", fmt::format("{} points to another part, {} to another rank",
                                                          text_of(reply, "moved"), text_of(reply, "migrated")));
  facts.add("axes flipped", text_of(reply, "axes_flipped"));
  if (const auto quality = reply.find("quality"); quality != reply.end() && quality->is_object()) {
    std::uint64_t ghosts = 0;
    for (const Json& count : quality->at("ghosts")) ghosts += count.get<std::uint64_t>();
    facts.add("interface", text_of(*quality, "interface_area"));
    facts.add("ghosts", fmt::format("{} within {}", ghosts, text_of(*quality, "ghost_width")));
  }
  facts.add("epoch", text_of(reply, "epoch"));
  facts.add("result", text_of(reply, "reason"));
  facts.add("time", milliseconds(reply.value("seconds", 0.0)) + " ms");
  facts.print();
}

Status rebalance(const RebalanceOptions& options, const Context& context) {
  Json arguments{
      {"scene", options.name}, {"dry_run", options.dry_run}, {"force", options.force}, {"held", options.held}};
  if (options.method) arguments["method"] = *options.method;
  if (options.parts) arguments["parts"] = *options.parts;
  if (options.tolerance) arguments["tolerance"] = tolerance_json(*options.tolerance);
  return ask_and_show(
      context, "rebalance", arguments, [&](const Json& reply) { print(reply, options.dry_run); },
      options.deadline_seconds);
}

}  // namespace

void add_rebalance_command(CLI::App& app, Context& context) {
  auto [command, options] = add_command(
      app, context,
      {"rebalance", "Repartitions now; a method, tolerance or number of parts that is given holds from then on",
       "  rcbctl rebalance jet --dry-run\n  rcbctl rebalance jet --parts 12", kSceneGroup},
      rebalance);
  add_scene_name(command, options.name);
  add_value(command, "--method", options.method, kind::method(), "rcb, bands-x, bands-y or bands-z");
  add_value(command, "--parts", options.parts, kind::part_count(), "number of parts");
  add_value(command, "--tolerance", options.tolerance, kind::tolerance(), kToleranceHelp);
  command.add_flag("--force", options.force, "change the number of parts even under those who have the scene open");
  add_deadline(command, options.deadline_seconds);
  add_held(command, options.held);
  command.add_flag("--dry-run", options.dry_run, "tell error, points to move and quality; change nothing");
}

}  // namespace rcb::cli
