// rcbctl: asks and commands a partitioning service.
#include <algorithm>
#include <csignal>
#include <cstdlib>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "client/cli/app.hpp"
#include "client/cli/output.hpp"

namespace rcb::cli {
namespace {

constexpr const char* kFooter = R"(Environment:
  RCBD_ENDPOINT  the service: unix:PATH or HOST:PORT (--endpoint wins)
  RCBD_BIN_DIR   where rcbd is
  NO_COLOR       no colours

Exit codes: 0 done; 1 the service refused or failed; 2 wrong usage; 3 no service reachable; 4 not authorised;
5 a deadline passed.

Examples:
  rcbctl partition points.csv --parts 8
  rcbctl up -n 8
  rcbctl replay jet run.npy --parts 8 --tolerance 0.1
  rcbctl history jet --plot error.svg
)";

// "-.5" is a number, which the parser would take for an option "-.": it reads "-0.5" instead.
std::string plain_number(const char* argument) {
  const std::string text = argument;
  if (text.size() < 3 || text[0] != '-' || text[1] != '.') return text;
  char* end = nullptr;
  (void)std::strtod(argument, &end);
  return *end == '\0' ? "-0" + text.substr(1) : text;
}

void add_commands(CLI::App& app, Context& context) {
  app.add_flag("--json", context.json, "one JSON document on standard output");
  app.add_option("--endpoint", context.endpoint, "the service: unix:PATH or HOST:PORT")->envname("RCBD_ENDPOINT");
  app.set_version_flag("--version", std::string("rcbctl " RCB_VERSION));
  app.footer(kFooter);
  app.require_subcommand(1);
  add_service_commands(app, context);
  add_partition_command(app, context);
  add_compare_command(app, context);
  add_scene_commands(app, context);
  add_push_commands(app, context);
  add_read_commands(app, context);
  add_where_commands(app, context);
  add_history_command(app, context);
  add_rebalance_command(app, context);
  add_export_command(app, context);
  add_watch_command(app, context);
  add_completion_command(app, context);
}

Status run(const std::function<Status()>& action) {
  try {
    return action();
  } catch (const nlohmann::json::exception& error) {
    return {Code::protocol_error, fmt::format("the service's answer is not as expected: {}", error.what()),
            "rcbctl and rcbd may be of different versions"};
  } catch (const std::bad_alloc&) {
    return {Code::too_large, "out of memory"};
  } catch (const std::exception& error) {
    return {Code::internal, error.what()};
  }
}

Status usage_failure(const CLI::App& app, const CLI::ParseError& error, const std::vector<std::string>& arguments) {
  std::string name;
  const CLI::App* chosen = &app;
  while (!chosen->get_subcommands().empty()) {
    chosen = chosen->get_subcommands().front();
    name += " " + chosen->get_name();
  }
  std::string message = error.what();
  const auto word = std::find_if(arguments.begin(), arguments.end(), [](const auto& a) { return !a.starts_with('-'); });
  if (chosen == &app && word != arguments.end()) message = fmt::format("there is no command {}", *word);
  return {Code::usage, message, fmt::format("rcbctl{} --help", name)};
}

int main_in(const std::vector<std::string>& arguments, bool json_asked) {
  CLI::App app("Asks and commands rcbd, the partitioning service for particle simulations.", "rcbctl");
  Context context;
  add_commands(app, context);
  try {
    // The parser takes them last first.
    std::vector<std::string> reversed(arguments.rbegin(), arguments.rend());
    app.parse(reversed);
  } catch (const CLI::CallForVersion&) {
    if (json_asked)
      print_json({{"program", "rcbctl"}, {"version", RCB_VERSION}});
    else
      print_line("rcbctl " RCB_VERSION);
    return 0;
  } catch (const CLI::Success& help) {
    if (json_asked)
      print_json({{"help", app.help()}});
    else
      app.exit(help);
    return 0;
  } catch (const CLI::ParseError& error) {
    return print_failure(usage_failure(app, error, arguments), json_asked);
  }
  Status status = run(context.action);
  if (status) status = flush_output();
  return status ? 0 : print_failure(status, context.json && !context.document_begun);
}

}  // namespace
}  // namespace rcb::cli

int main(int argc, char** argv) {
  std::signal(SIGPIPE, SIG_IGN);  // told as a failure instead
  std::vector<std::string> arguments;
  for (int i = 1; i < argc; ++i) arguments.push_back(rcb::cli::plain_number(argv[i]));
  const bool json_asked = std::find(arguments.begin(), arguments.end(), "--json") != arguments.end();
  return rcb::cli::main_in(arguments, json_asked);
}
