// error, counts, cuts, stats, quality.
#include <numeric>

#include <fmt/format.h>

#include "client/cli/app.hpp"
#include "client/cli/output.hpp"

namespace rcb::cli {
namespace {

using Printer = std::function<void(const Json&)>;

Status read(const Context& context, const std::string& command, const Json& arguments, const Printer& print) {
  auto client = connect(context);
  if (!client) return client.status();
  auto reply = ask(*client, command, arguments);
  if (!reply) return reply.status();
  if (context.json)
    print_json(*reply);
  else
    print(*reply);
  return {};
}

void print_error(const Json& reply) {
  Facts facts;
  for (const char* field : {"error", "tolerance", "imbalance", "step", "epoch"})
    facts.add(field, text_of(reply, field));
  facts.print();
}

void print_counts(const Json& reply) {
  const Json& counts = reply.at("counts");
  const Json& targets = reply.at("targets");
  const bool weighted = reply.contains("loads");
  Table table({{"part"}, {"points"}, {weighted ? "load" : ""}, {"target"}, {"error"}});
  for (std::size_t p = 0; p < counts.size(); ++p) {
    const double load = weighted ? reply["loads"].at(p).get<double>() : counts[p].get<double>();
    const double target = targets.at(p).get<double>();
    const std::string error = target > 0 ? percent((load - target) / target) : "-";
    table.row(
        {std::to_string(p), text_of(counts[p]), weighted ? number(load) : "", fmt::format("{:.10g}", target), error});
  }
  table.print();
}

// "x 0.5, then y 1 (id 7)": the whole key of a cut.
std::string cut_text(const Json& cut) {
  if (cut.at("at").is_null()) return "all left";
  return fmt::format("{:.17g}", cut["at"].get<double>());
}

std::string child_text(const Json& child) {
  return child.contains("part") ? "part " + text_of(child, "part") : "cut " + text_of(child, "node");
}

std::string axis_text(const Json& axis) {
  if (!axis.is_number_integer()) return text_of(axis);
  const auto k = axis.get<int>();
  return k >= 0 && k < 3 ? std::string(1, "xyz"[k]) : text_of(axis);
}

std::string bounds_text(const Json& region) {
  const Json& lo = region.at("lo");
  const Json& hi = region.at("hi");
  std::string text;
  for (std::size_t a = 0; a < lo.size(); ++a)
    text += fmt::format("{}[{}, {})", a == 0 ? "" : " x ", lo[a].is_null() ? "-inf" : text_of(lo[a]),
                        hi.at(a).is_null() ? "inf" : text_of(hi[a]));
  return text;
}

void print_cuts(const Json& reply) {
  print_line(fmt::format("{}, {} parts, epoch {}, hash {}", text_of(reply, "method"), text_of(reply, "parts"),
                         text_of(reply, "epoch"), text_of(reply, "hash")));
  print_line("");
  Table cuts({{"cut"}, {"axis"}, {"at"}, {"below", Table::Align::left}, {"from there", Table::Align::left}});
  for (const Json& cut : reply.at("cuts"))
    cuts.row({text_of(cut, "node"), axis_text(cut.at("axis")), cut_text(cut), child_text(cut.at("left")),
              child_text(cut.at("right"))});
  cuts.print();
  print_line("");
  Table regions({{"part"}, {"region", Table::Align::left}});
  for (const Json& region : reply.at("regions"))
    regions.row({text_of(region, "part"), region.value("empty", false) ? "empty" : bounds_text(region)});
  regions.print();
}

void print_stats(const Json& reply) {
  Facts facts;
  for (const char* field : {"scene", "steps", "repartitions", "bytes", "drifted", "moved", "migrated", "scanned",
                            "searched", "rounds", "reductions"})
    facts.add(field, text_of(reply, field));
  for (const auto& [name, times] : reply.at("skipped").items()) facts.add("skipped: " + name, text_of(times));
  for (const auto& [name, times] : reply.at("asked").items()) facts.add("asked: " + name, text_of(times));
  for (const auto& [name, seconds] : reply.at("seconds").items()) facts.add("seconds: " + name, text_of(seconds));
  facts.print();
}

void print_quality(const Json& reply) {
  const Json areas = reply.value("interface_areas", Json());
  const Json& neighbours = reply.at("neighbours");
  const Json& ghosts = reply.at("ghosts");
  Table table({{"part"}, {"neighbours"}, {"ghosts"}, {"interface"}});
  std::uint64_t all_ghosts = 0;
  for (std::size_t p = 0; p < ghosts.size(); ++p) {
    all_ghosts += ghosts[p].get<std::uint64_t>();
    table.row({std::to_string(p), text_of(neighbours.at(p)), text_of(ghosts[p]),
               areas.is_array() ? text_of(areas.at(p)) : "-"});
  }
  table.row({"all", "", std::to_string(all_ghosts), text_of(reply, "interface_area")});
  table.print();
  print_line("ghost width " + text_of(reply, "ghost_width"));
}

void add_read(CLI::App& app, Context& context, const CommandText& text, Printer print) {
  auto name = std::make_shared<std::string>();
  CLI::App* command = add_command(app, context, text, [name, &context, print, command_name = std::string(text.name)] {
    return read(context, command_name, {{"scene", *name}}, print);
  });
  command->add_option("NAME", *name, "the scene")->required();
}

}  // namespace

void add_read_commands(CLI::App& app, Context& context) {
  add_read(app, context, {"error", "The load-balance error as it stands", "  rcbctl error jet"}, print_error);
  add_read(app, context, {"counts", "Points of each part, beside its target", "  rcbctl counts jet --json"},
           print_counts);
  add_read(app, context, {"cuts", "The cuts in force and the region of each part", "  rcbctl cuts jet --json"},
           print_cuts);
  add_read(app, context, {"stats", "Totals of a scene, and what was skipped", "  rcbctl stats jet"}, print_stats);

  struct Options {
    std::string name;
    std::optional<double> ghost_width;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = add_command(app, context,
                                  {"quality", "Interface area, neighbours and ghosts of each part",
                                   "  rcbctl quality jet\n  rcbctl quality jet --ghost-width 0.05"},
                                  [options, &context] {
                                    Json arguments{{"scene", options->name}};
                                    if (options->ghost_width) arguments["ghost_width"] = *options->ghost_width;
                                    return read(context, "quality", arguments, print_quality);
                                  });
  command->add_option("NAME", options->name, "the scene")->required();
  command->add_option("--ghost-width", options->ghost_width, "default: 2 (box volume / points)^(1/dims)")
      ->check(number_from_zero());
}

}  // namespace rcb::cli
