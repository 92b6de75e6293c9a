// rcbctl: the command line of the partitioning service.
#include <algorithm>
#include <cctype>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <sys/stat.h>

#include "client/cli/app.hpp"
#include "client/cli/interrupt.hpp"
#include "client/cli/options.hpp"
#include "client/cli/print/output.hpp"
#include "client/cli/usage.hpp"
#include "common/base/child.hpp"
#include "common/files/descriptor.hpp"

namespace rcb::cli {
namespace {

constexpr const char* kFooter = R"(rcbctl COMMAND --help tells what each command takes.

Environment:
  RCBD_ENDPOINT    the service: unix:PATH, HOST:PORT or file:PATH (--endpoint wins)
  RCBD_TOKEN_FILE  the service's token, for one over TCP that runs on another machine; RCBD_TOKEN: the token itself
  RCBD_BIN_DIR     where rcbd is
  NO_COLOR         no colours

Exit codes: 0 done; 1 the service refused or failed; 2 wrong usage; 3 no service reachable; 4 not authorised;
5 a deadline passed; 130 interrupted by Ctrl-C.

Examples:
  rcbctl partition points.csv --parts 8
  rcbctl up -n 8
  rcbctl replay jet run.npy --parts 8 --tolerance 0.1
  rcbctl history jet --plot error.svg
)";

// "-.5" and "-inf" are numbers, but the parser takes them for options "-." and "-i": so they are rewritten.
std::string plain_number(const char* argument) {
  const std::string text = argument;
  if (text.size() < 3 || text[0] != '-') return text;
  char* end = nullptr;
  const double value = std::strtod(argument, &end);
  if (*end != '\0') return text;
  if (text[1] == '.') return "-0" + text.substr(1);
  return std::isinf(value) && std::isalpha(static_cast<unsigned char>(text[1])) != 0 ? kMinusInfinity : text;
}

void add_commands(CLI::App& app, Context& context) {
  app.add_flag("--json", context.json, "one JSON document on standard output");
  add_value(
      app, "--endpoint", context.endpoint, kind::text("E"),
      "the service: unix:PATH, HOST:PORT, or file:PATH, which 'up --publish' writes (default: RCBD_ENDPOINT, then your "
      "own socket, then 127.0.0.1:7470)")
      ->envname("RCBD_ENDPOINT");
  app.set_help_flag("-h,--help", "this page");
  app.set_version_flag("--version", std::string("rcbctl " RCB_VERSION), "the version");
  app.footer(kFooter);
  app.require_subcommand(1);
  add_service_commands(app, context);
  add_status_command(app, context);
  add_partition_command(app, context);
  add_compare_command(app, context);
  add_scene_commands(app, context);
  add_push_command(app, context);
  add_replay_commands(app, context);
  add_read_commands(app, context);
  add_cuts_command(app, context);
  add_where_commands(app, context);
  add_halo_commands(app, context);
  add_history_command(app, context);
  add_rebalance_command(app, context);
  add_export_command(app, context);
  add_watch_command(app, context);
  add_completion_command(app, context);
}

Status odd_answer(const std::exception& error) {
  return {Code::protocol_error, fmt::format("the service's answer is not as expected: {}", error.what()),
          "rcbctl and rcbd may be of different versions"};
}

Status run(const std::function<Status()>& action) {
  try {
    return action();
  } catch (const nlohmann::json::exception& error) {
    return odd_answer(error);
  } catch (const std::out_of_range& error) {
    return odd_answer(error);
  } catch (const std::bad_alloc&) {
    return {Code::too_large, "out of memory"};
  } catch (const std::exception& error) {
    return {Code::internal, error.what()};
  }
}

// Ends as programs do whose reader closes the pipe early: `history jet | head` is no failure, so nothing is printed.
int end_by_closed_pipe() {
  std::signal(SIGPIPE, SIG_DFL);
  std::raise(SIGPIPE);
  return 128 + SIGPIPE;
}

int main_in(const std::vector<std::string>& arguments, bool json_asked) {
  CLI::App app("Asks and commands rcbd, the partitioning service for particle simulations.", "rcbctl");
  app.formatter(help_format());
  Context context;
  add_commands(app, context);
  try {
    // The parser takes them in reverse order.
    std::vector<std::string> reversed(arguments.rbegin(), arguments.rend());
    app.parse(reversed);
  } catch (const CLI::CallForVersion&) {
    if (json_asked)
      print_json({{"program", "rcbctl"}, {"version", RCB_VERSION}});
    else
      print_line("rcbctl " RCB_VERSION);
    context.action = [] { return Status(); };
  } catch (const CLI::Success& help) {
    if (json_asked)
      print_json({{"help", app.help()}});
    else
      app.exit(help);
    context.action = [] { return Status(); };
  } catch (const CLI::ParseError& error) {
    return print_failure(usage_failure(app, error), json_asked);
  }
  Status status = run(context.action);
  if (status) status = flush_output();
  if (status && output_cut_off()) return end_by_closed_pipe();
  if (!status && interrupted() && status.code() != Code::interrupted) status = interruption(": " + status.message());
  return status ? 0 : print_failure(status, context.json && !context.document_begun);
}

}  // namespace
}  // namespace rcb::cli

int main(int argc, char** argv) {
  rcb::open_standard_streams();
  ::umask(::umask(0) & 0077);     // files that their owner can't read would serve nobody
  rcb::keep_ended_children();     // of programs that read and plot files
  std::signal(SIGXFSZ, SIG_IGN);  // a write beyond the limit for files fails, and is told
  std::signal(SIGPIPE, SIG_IGN);  // ignored, so that a temporary scene or embedded service is removed before the end
  std::vector<std::string> arguments;
  for (int i = 1; i < argc; ++i) arguments.push_back(rcb::cli::plain_number(argv[i]));
  const bool json_asked = std::find(arguments.begin(), arguments.end(), "--json") != arguments.end();
  return rcb::cli::main_in(arguments, json_asked);
}
