// status: what runs, what is wrong with it, and the scenes.
#include <algorithm>

#include <fmt/format.h>

#include "client/cli/app.hpp"
#include "client/cli/print/output.hpp"

namespace rcb::cli {
namespace {

std::string ranks_text(const Json& status) {
  const Json silent = status.value("silent", Json::array());
  if (silent.empty()) return text_of(status, "ranks");
  return fmt::format("{}, of which {} silent", text_of(status, "ranks"), silent.size());
}

// Printed first, since silent ranks may make the rest out of date.
void print_silent(const Json& status) {
  for (const Json& rank : status.value("silent", Json::array()))
    print_line(warning(fmt::format("rank {} silent for {:.0f} s", text_of(rank, "rank"), rank.value("seconds", 0.0))));
}

// What the engine has been at for longer than people like to wait without a word.
void print_unfinished(const Json& status) {
  constexpr double kSeconds = 2;
  const Json unfinished = status.value("unfinished", Json::object());
  const Json oldest = unfinished.value("oldest", Json());
  const double seconds = oldest.is_object() ? oldest.value("seconds", 0.0) : 0;
  if (seconds < kSeconds) return;
  const Json scene = oldest.value("scene", Json());
  print_line(
      warning(fmt::format("{}{} at work for {:.0f} s; {} command(s) unfinished", text_of(oldest, "command"),
                          scene.is_null() ? "" : " of " + text_of(scene), seconds, text_of(unfinished, "commands"))));
}

// "a (ranks 0-3), b (4)"; empty if all ranks are on one machine.
std::string hosts_text(const Json& status) {
  std::vector<std::pair<std::string, std::vector<int>>> hosts;
  for (const Json& one : status.value("hosts", Json::array())) {
    const std::string name = one.value("host", "");
    if (hosts.empty() || hosts.back().first != name) hosts.push_back({name, {}});
    hosts.back().second.push_back(one.value("rank", 0));
  }
  std::string text;
  for (const auto& [name, ranks] : hosts)
    text += fmt::format("{}{} ({})", text.empty() ? "" : ", ", name,
                        ranks.size() == 1 ? fmt::format("rank {}", ranks.front())
                                          : fmt::format("ranks {}-{}", ranks.front(), ranks.back()));
  return hosts.size() < 2 ? "" : text;
}

// Of an earlier service; empty: nothing.
std::string restored_text(const Json& status) {
  const Json restored = status.value("restored", Json::object());
  const auto number = [&restored](const char* name) { return restored.value(name, std::uint64_t{0}); };
  if (number("scenes") == 0) return status.value("restarted", false) ? "it had no scenes" : "";
  std::string text = fmt::format("{} scene{}, {} step{} restored", number("scenes"), number("scenes") == 1 ? "" : "s",
                                 number("steps"), number("steps") == 1 ? "" : "s");
  if (number("lost_records") > 0) text += fmt::format("; {} step reports are lost", number("lost_records"));
  return text;
}

void print_facts(const Json& status) {
  Facts facts;
  facts.add("version", text_of(status, "version"));
  facts.add("endpoint", text_of(status, "endpoints"));
  const Json endpoints = status.value("endpoints", Json::array());
  const auto is_unix = [](const Json& one) { return one.get<std::string>().starts_with("unix:"); };
  if (!std::all_of(endpoints.begin(), endpoints.end(), is_unix)) facts.add("encryption", text_of(status, "encryption"));
  facts.add("ranks", ranks_text(status));
  if (const std::string hosts = hosts_text(status); !hosts.empty()) facts.add("hosts", hosts);
  facts.add("uptime", duration(status.value("uptime_seconds", 0.0)));
  const bool restarted = status.value("restarted", false);
  if (const std::string text = restored_text(status); restarted || !text.empty())
    facts.add(restarted ? "restarted" : "restored", (restarted ? "yes, after it had died: " : "") + text);
  facts.add("clients", text_of(status, "sessions"));
  facts.add("steps", text_of(status, "steps"));
  facts.add("memory", memory_text(status));
  if (status.contains("log")) facts.add("log", text_of(status, "log"));
  facts.print();
}

// Mean over the steps so far.
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
               step_milliseconds(scene), holders_text(scene)});
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
              [&context] {
                return ask_and_show(context, "status", Json::object(), [](const Json& reply) {
                  print_silent(reply);
                  print_unfinished(reply);
                  print_facts(reply);
                  print_line("");
                  print_scenes(reply.value("scenes", Json::array()));
                });
              });
}

}  // namespace rcb::cli
