// Rooms: `commands` has one file for each family of commands, `print` the output, `files` the reading and writing of
// point files.
//
// What all commands of rcbctl share: the global flags, how a command is added, and how it connects to a service.
//
// Invariants
// 1. Parsing a command line does nothing; it sets an action, which runs after the whole line was found correct.
// 2. stdout carries data only: with --json exactly one document, also after a failure.
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
#include "client/launch/job/programs.hpp"
#include "client/launch/launch.hpp"
#include "client/launch/reach.hpp"
#include "client/lib/client.hpp"
#include "common/base/status.hpp"

namespace rcb::cli {

using Json = nlohmann::ordered_json;

struct Context {
  bool json = false;
  std::string endpoint;  // empty: as the client library finds it
  std::function<Status()> action;
  mutable bool document_begun = false;  // set once output has begun: a failure is then reported on stderr only
};

// The end of most commands: the document with --json, else what `for_people` prints.
Status show(const Context& context, const Json& document, const std::function<void()>& for_people);

struct CommandText {
  const char* name;
  const char* description;
  const char* examples;            // shown at the end of --help
  const char* group = "Commands";  // under which the parent's --help lists it
};

inline constexpr const char* kServiceGroup = "A service";
inline constexpr const char* kFileGroup = "One file of points, without a scene";
inline constexpr const char* kSceneGroup = "Scenes and their steps";
inline constexpr const char* kAskGroup = "Questions about a scene";

// Adds a subcommand whose action is `run`.
CLI::App* add_command(CLI::App& parent, Context& context, const CommandText& text, std::function<Status()> run);

// A subcommand and the options that it fills in; these live as long as the command.
template <typename Options>
struct Added {
  CLI::App& command;
  Options& options;
};
// Adds one whose action is run(options, context).
template <typename Options>
Added<Options> add_command(CLI::App& parent, Context& context, const CommandText& text,
                           Status (*run)(const Options&, const Context&)) {
  auto options = std::make_shared<Options>();
  CLI::App* command = add_command(parent, context, text, [options, &context, run] { return run(*options, context); });
  return {*command, *options};
}

// Adds the argument NAME of a command on a scene.
void add_scene_name(CLI::App& command, std::string& name);
// Adds the options of a scene that is to be made, except for --parts and --dims.
void add_scene_options(CLI::App& command, client::SceneOptions& scene);

// Adds --deadline, for a command that may take long.
void add_deadline(CLI::App& command, double& seconds);

// Adds --held, for a question about positions.
void add_held(CLI::App& command, bool& held);

// One function for each family of commands.
void add_service_commands(CLI::App& app, Context& context);    // up, down
void add_status_command(CLI::App& app, Context& context);      // status
void add_partition_command(CLI::App& app, Context& context);   // partition
void add_compare_command(CLI::App& app, Context& context);     // compare
void add_scene_commands(CLI::App& app, Context& context);      // scene create, list, show, drop
void add_push_command(CLI::App& app, Context& context);        // push
void add_replay_commands(CLI::App& app, Context& context);     // replay, stream
void add_read_commands(CLI::App& app, Context& context);       // error, counts, stats, quality
void add_cuts_command(CLI::App& app, Context& context);        // cuts
void add_where_commands(CLI::App& app, Context& context);      // owner, box, assign
void add_halo_commands(CLI::App& app, Context& context);       // halo, neighbours
void add_history_command(CLI::App& app, Context& context);     // history
void add_rebalance_command(CLI::App& app, Context& context);   // rebalance
void add_export_command(CLI::App& app, Context& context);      // export
void add_watch_command(CLI::App& app, Context& context);       // watch
void add_completion_command(CLI::App& app, Context& context);  // completion

// Checks the endpoint, if one is given. Errors: usage.
Status check_endpoint(const Context& context);
// Connects to the service at the endpoint. Waits a few seconds for one that is being restarted. Errors: usage, those of
// Client::connect.
Result<client::Client> connect(const Context& context);
// The same for a command that pushes step after step, as a solver does: its calls wait for a service that has gone.
Result<client::Client> connect_persistent(const Context& context);

// A service to work with: the running one or one embedded in this program. Members are in this order so that the client
// is destroyed before its service.
struct Session {
  std::optional<launch::Embedded> embedded;
  std::optional<client::Client> client;

  // ranks > 0: always an embedded one with so many ranks; 0: the running one, else an embedded one with as many ranks
  // as cores, at most 8.
  static Result<Session> open(const Context& context, int ranks);
  // Adds the end of an embedded service's log to an error.
  Status explain(Status status) const { return embedded ? embedded->explain(std::move(status)) : status; }
};

// The deadline of a question, unless its user says another one.
inline constexpr double kQuestionSeconds = 60;
// The deadline of what a file of any size takes.
inline constexpr double kLongSeconds = 3600;

// JSON, and so the service, is told no other text.
bool is_utf8(const std::string& text);
// A command's reply, parsed, with its long lists filled in. Errors: the service's; protocol_error if it isn't JSON;
// usage if an argument isn't UTF-8.
Result<Json> ask(client::Client& client, const std::string& command, const Json& arguments,
                 double deadline_seconds = kQuestionSeconds);
// The parsed reply and the arrays that came with it.
struct Answer {
  Json json;
  client::Reply reply;
};
Result<Answer> ask_arrays(client::Client& client, const std::string& command, const Json& arguments,
                          double deadline_seconds = kQuestionSeconds);

// A whole command: connects, asks, and shows the reply. Errors: those of connect() and ask().
Status ask_and_show(const Context& context, const std::string& command, const Json& arguments,
                    const std::function<void(const Json& reply)>& for_people,
                    double deadline_seconds = kQuestionSeconds);

// The reply to `cuts`, assembled from its pages. Errors also: aborted, if the cuts kept changing.
Result<Json> ask_cuts(client::Client& client, const std::string& scene);

// Prints the scenes of `status` or `scene.list` as a table.
void print_scenes(const Json& scenes);
// The memory of the service's ranks, from the reply to `status`.
std::string memory_text(const Json& status);

// "inf" for infinity, as in the protocol.
Json tolerance_json(double tolerance);

}  // namespace rcb::cli
