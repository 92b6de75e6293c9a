// status: what runs, what of it is amiss, and the scenes.
#include <fmt/format.h>

#include "client/cli/app.hpp"
#include "client/cli/output.hpp"

namespace rcb::cli {
namespace {

std::string ranks_text(const Json& status) {
  const Json silent = status.value("silent", Json::array());
  if (silent.empty()) return text_of(status, "ranks");
  return fmt::format("{}, of which {} silent", text_of(status, "ranks"), silent.size());
}

// First, since what follows may no longer be so.
void print_silent(const Json& status) {
  for (const Json& rank : status.value("silent", Json::array()))
    print_line(warning(fmt::format("rank {} silent for {:.0f} s", text_of(rank, "rank"), rank.value("seconds", 0.0))));
}

void print_facts(const Json& status) {
  Facts facts;
  facts.add("version", text_of(status, "version"));
  facts.add("endpoint", text_of(status, "endpoints"));
  facts.add("ranks", ranks_text(status));
  facts.add("uptime", duration(status.value("uptime_seconds", 0.0)));
  if (status.value("restarted", false)) facts.add("restarted", "yes, after it had died: what it held before is lost");
  facts.add("clients", text_of(status, "sessions"));
  facts.add("steps", text_of(status, "steps"));
  facts.add("memory", memory_text(status));
  if (status.contains("log")) facts.add("log", text_of(status, "log"));
  facts.print();
}

// Of the steps so far, on average.
std::string step_milliseconds(const Json& scene) {
  const Json seconds = scene.value("mean_step_seconds", Json());
  return seconds.is_number() ? milliseconds(seconds.get<double>()) : "-";
}

}  // namespace

void print_scenes(const Json& scenes) {
  if (scenes.empty()) {
    print_line("no scenes");
    return;
  }
  Table table({{"scene", Table::Align::left},
               {"points"},
               {"dims"},
               {"parts"},
               {"step"},
               {"epoch"},
               {"error"},
               {"imbalance"},
               {"ms a step"},
               {"open by", Table::Align::left}});
  for (const Json& scene : scenes)
    table.row({text_of(scene, "scene"), text_of(scene, "n"), text_of(scene, "dims"), text_of(scene, "parts"),
               text_of(scene, "step"), text_of(scene, "epoch"), text_of(scene, "error"), text_of(scene, "imbalance"),
               step_milliseconds(scene), text_of(scene, "holders")});
  table.print();
}

std::string memory_text(const Json& status) {
  const Json list = status.value("memory_bytes", Json());
  if (!list.is_array() || list.empty()) return "-";
  double sum = 0, most = 0;
  for (const Json& bytes : list) {
    if (!bytes.is_number()) return "-";  // it has just started
    sum += bytes.get<double>();
    most = std::max(most, bytes.get<double>());
  }
  return fmt::format("{} in {} rank{}, {} in the largest", size(sum), list.size(), list.size() == 1 ? "" : "s",
                     size(most));
}

void add_status_command(CLI::App& app, Context& context) {
  add_command(app, context,
              {"status", "What runs: ranks, memory, log; the scenes, their error and who holds them",
               "  rcbctl status\n  rcbctl status --json", kServiceGroup},
              [&context]() -> Status {
                auto client = connect(context);
                if (!client) return client.status();
                auto reply = ask(*client, "status", Json::object());
                if (!reply) return reply.status();
                if (context.json) {
                  print_json(*reply);
                  return {};
                }
                print_silent(*reply);
                print_facts(*reply);
                print_line("");
                print_scenes(reply->value("scenes", Json::array()));
                return {};
              });
}

}  // namespace rcb::cli
