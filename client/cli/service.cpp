// up, down, status.
#include <fmt/format.h>

#include "client/cli/app.hpp"
#include "client/cli/output.hpp"
#include "client/lib/endpoint.hpp"
#include "common/base/own_files.hpp"
#include "common/base/paths.hpp"

namespace rcb::cli {
namespace {

constexpr int kRanksMax = 4096;

struct UpOptions {
  int ranks = 0;
  std::string data_dir;
  bool foreground = false;
  double deadline = 60;
  double answer_seconds = 30;
  // What rcbd itself is told, at this start and at each that follows a death.
  std::vector<std::string> files_below;
  std::string keep_reports;
  std::string log_level;
  std::string bulk_bytes;
};

// An option of rcbd that `up` takes too is added here and in add_up_options. rcbd checks the values.
std::vector<std::string> service_arguments(const UpOptions& options) {
  std::vector<std::string> arguments;
  const auto add = [&arguments](const char* name, const std::string& value) {
    if (!value.empty()) arguments.insert(arguments.end(), {name, value});
  };
  for (const std::string& folder : options.files_below)
    add("--files-below", std::filesystem::absolute(folder).lexically_normal().string());
  add("--keep-reports", options.keep_reports);
  add("--log-level", options.log_level);
  add("--bulk-bytes", options.bulk_bytes);
  return arguments;
}

Status up(const UpOptions& options, const Context& context) {
  launch::SuperviseOptions service;
  const auto endpoint = client::endpoint_to_serve(context.endpoint);
  if (!endpoint) return endpoint.status();
  service.endpoint = endpoint->text();
  service.ranks = options.ranks > 0 ? options.ranks : launch::default_ranks();
  service.ready_seconds = options.deadline;
  service.silence_seconds = options.answer_seconds;
  service.ask_seconds = std::min(service.ask_seconds, options.answer_seconds / 3);
  service.service_arguments = service_arguments(options);
  auto running = launch::reach(service.endpoint, "rcbctl up");
  if (running || running.status().code() == Code::not_authorised)
    return {Code::already_exists, "a service already answers at " + service.endpoint,
            "use it, or stop it first: rcbctl down"};
  if (options.data_dir.empty()) {
    service.data_dir = client::data_directory(*endpoint);
    if (Status status = make_private_directory(service.data_dir); !status) return status;
  } else {
    service.data_dir = std::filesystem::absolute(options.data_dir).lexically_normal().string();
    if (Status status = make_own_directory(service.data_dir); !status) return status;
  }
  if (options.foreground) {
    note(fmt::format("{} ranks on {}; log: {}", service.ranks, service.endpoint, launch::log_path(service.data_dir)));
    return launch::supervise(service);
  }
  {
    Progress progress(fmt::format("starting {} ranks on {}", service.ranks, service.endpoint));
    Status status = launch::start_detached(service, [&progress](double seconds) { progress.seconds(seconds); });
    if (!status) return status;
  }
  const std::string log = launch::log_path(service.data_dir);
  if (context.json) {
    print_json(
        {{"endpoint", service.endpoint}, {"ranks", service.ranks}, {"data_dir", service.data_dir}, {"log", log}});
    return {};
  }
  Facts facts;
  facts.add("endpoint", service.endpoint);
  facts.add("ranks", std::to_string(service.ranks));
  facts.add("log", log);
  facts.print();
  return {};
}

Status down(double deadline, const Context& context) {
  const auto stopped = launch::stop_service(context.endpoint, deadline);
  if (!stopped) return stopped.status();
  if (context.json)
    print_json({{"endpoint", stopped->endpoint}, {"stopped", true}, {"said", stopped->said}});
  else
    print_line(stopped->said);
  return {};
}

Status status(const Context& context) {
  auto client = connect(context);
  if (!client) return client.status();
  auto reply = ask(*client, "status", Json::object());
  if (!reply) return reply.status();
  if (context.json) {
    print_json(*reply);
    return {};
  }
  Facts facts;
  facts.add("version", text_of(*reply, "version"));
  facts.add("endpoint", text_of(*reply, "endpoints"));
  facts.add("ranks", text_of(*reply, "ranks"));
  facts.add("uptime", duration(reply->value("uptime_seconds", 0.0)));
  facts.add("sessions", text_of(*reply, "sessions"));
  facts.add("steps", text_of(*reply, "steps"));
  if (reply->value("restarted", false)) facts.add("restarted", "yes, after it had died");
  facts.print();
  const Json scenes = reply->value("scenes", Json::array());
  if (scenes.empty()) {
    print_line("no scenes");
    return {};
  }
  print_line("");
  Table table({{"scene", Table::Align::left}, {"points"}, {"dims"}, {"parts"}, {"step"}, {"epoch"}});
  for (const Json& scene : scenes)
    table.row({text_of(scene, "scene"), text_of(scene, "n"), text_of(scene, "dims"), text_of(scene, "parts"),
               text_of(scene, "step"), text_of(scene, "epoch")});
  table.print();
  return {};
}

void add_up_options(CLI::App& command, UpOptions& options) {
  command.add_option("-n,--ranks", options.ranks, "MPI ranks (default: one a core, at most 8)")
      ->check(CLI::Range(1, kRanksMax));
  command.add_option("--data-dir", options.data_dir, "for log, token and what lasts (default: one an endpoint)");
  command.add_option("--deadline", options.deadline, "seconds to wait for its first answer")
      ->capture_default_str()
      ->check(positive_number());
  command
      .add_option("--answer-seconds", options.answer_seconds,
                  "a service that has not answered for so long is killed and started again")
      ->capture_default_str()
      ->check(CLI::Range(1.0, 86400.0));
  command.add_flag("--foreground", options.foreground,
                   "stay and supervise it here until SIGTERM or SIGINT, as a systemd unit wants it");
  command
      .add_option("--files-below", options.files_below,
                  "a folder below which commands may read and write files; may be given more than once")
      ->type_name("DIR");
  command.add_option("--keep-reports", options.keep_reports, "step reports of a scene that are kept in memory")
      ->type_name("K");
  command.add_option("--log-level", options.log_level, "how much is logged: trace, debug, info, warn, error or off");
  command.add_option("--bulk-bytes", options.bulk_bytes,
                     "most bytes of arrays that all pushes together may hold, such as 4gb");
}

}  // namespace

void add_service_commands(CLI::App& app, Context& context) {
  auto up_options = std::make_shared<UpOptions>();
  CLI::App* command =
      add_command(app, context,
                  {"up", "Starts a local service on the endpoint and waits until it answers",
                   "  rcbctl up -n 8\n  rcbctl up --endpoint unix:$HOME/run/rcbd.sock --data-dir $HOME/run/rcbd"},
                  [up_options, &context] { return up(*up_options, context); });
  add_up_options(*command, *up_options);

  auto deadline = std::make_shared<double>(30);
  command = add_command(app, context,
                        {"down", "Stops the service cleanly and waits until it is gone",
                         "  rcbctl down\n  rcbctl down --endpoint unix:$HOME/run/rcbd.sock"},
                        [deadline, &context] { return down(*deadline, context); });
  command->add_option("--deadline", *deadline, "seconds to wait before it is ended by force")
      ->capture_default_str()
      ->check(positive_number());

  add_command(app, context,
              {"status", "What runs: version, ranks, scenes, steps, uptime", "  rcbctl status\n  rcbctl status --json"},
              [&context] { return status(context); });
}

}  // namespace rcb::cli
