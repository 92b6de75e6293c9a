// What all commands of rcbctl share: the global flags, how a command is added, and how it reaches a service.
//
// Invariants
// 1. A command does nothing while the line is parsed; it leaves an action, which runs when all of the line is right.
// 2. stdout carries data only: with --json exactly one document, a failure included.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "client/cli/options.hpp"
#include "client/launch/launch.hpp"
#include "client/launch/programs.hpp"
#include "client/launch/reach.hpp"
#include "client/lib/client.hpp"
#include "common/base/status.hpp"

namespace rcb::cli {

using Json = nlohmann::ordered_json;

struct Context {
  bool json = false;
  std::string endpoint;  // empty: as the client library finds it
  std::function<Status()> action;
  mutable bool document_begun = false;  // a failure from here on is told on stderr alone
};

struct CommandText {
  const char* name;
  const char* description;
  const char* examples;            // lines for the end of --help
  const char* group = "Commands";  // under which --help of the command above lists it
};

inline constexpr const char* kServiceGroup = "A service";
inline constexpr const char* kFileGroup = "One file of points, without a scene";
inline constexpr const char* kSceneGroup = "Scenes and their steps";
inline constexpr const char* kAskGroup = "Questions about a scene";

// Adds a subcommand whose action is `run`.
CLI::App* add_command(CLI::App& parent, Context& context, const CommandText& text, std::function<Status()> run);

// One a command family.
void add_service_commands(CLI::App& app, Context& context);    // up, down
void add_status_command(CLI::App& app, Context& context);      // status
void add_partition_command(CLI::App& app, Context& context);   // partition
void add_compare_command(CLI::App& app, Context& context);     // compare
void add_scene_commands(CLI::App& app, Context& context);      // scene create, list, show, drop
void add_push_commands(CLI::App& app, Context& context);       // push, replay
void add_read_commands(CLI::App& app, Context& context);       // error, counts, stats, quality
void add_cuts_command(CLI::App& app, Context& context);        // cuts
void add_where_commands(CLI::App& app, Context& context);      // owner, box, assign
void add_history_command(CLI::App& app, Context& context);     // history
void add_rebalance_command(CLI::App& app, Context& context);   // rebalance
void add_export_command(CLI::App& app, Context& context);      // export
void add_watch_command(CLI::App& app, Context& context);       // watch
void add_completion_command(CLI::App& app, Context& context);  // completion

// That the endpoint given, if any, is one. Errors: usage.
Status check_endpoint(const Context& context);
// The service at the endpoint. One that is being started again is waited for, for a few seconds. Errors: usage, those
// of Client::connect.
Result<client::Client> connect(const Context& context);
// The same for a command that pushes step after step, as a solver does: it outlives the service.
Result<client::Client> connect_to_drive(const Context& context);

// A service to work with: the running one or one embedded in this program. The client goes before its service.
struct Session {
  std::optional<launch::Embedded> embedded;
  std::optional<client::Client> client;

  // ranks > 0: always embedded, of so many; 0: the running one, else embedded of as many ranks as cores, at most 8.
  static Result<Session> open(const Context& context, int ranks);
  // A failure with what the embedded service's log says.
  Status explain(Status status) const { return embedded ? embedded->explain(std::move(status)) : status; }
};

// A command's reply, parsed, its long lists in it. Errors: the service's; protocol_error where it is no JSON.
Result<Json> ask(client::Client& client, const std::string& command, const Json& arguments,
                 double deadline_seconds = 60);
// The reply with its arrays beside it.
struct Answer {
  Json json;
  client::Reply reply;
};
Result<Answer> ask_arrays(client::Client& client, const std::string& command, const Json& arguments,
                          double deadline_seconds = 60);

// The reply to `cuts`, put together from its pages. Errors also: aborted where the cuts changed all the while.
Result<Json> ask_cuts(client::Client& client, const std::string& scene);

// The scenes of `status` or `scene.list` as a table.
void print_scenes(const Json& scenes);
// The memory of the service's ranks, from the reply to `status`.
std::string memory_text(const Json& status);

// "inf" for infinity, as the protocol has it.
Json tolerance_json(double tolerance);

}  // namespace rcb::cli
