#include "client/cli/app.hpp"

#include <cmath>

#include <fmt/format.h>

#include "client/cli/interrupt.hpp"
#include "client/cli/lists.hpp"
#include "client/cli/print/output.hpp"
#include "client/lib/connect/endpoint.hpp"

namespace rcb::cli {
CLI::App* add_command(CLI::App& parent, Context& context, const CommandText& text, std::function<Status()> run) {
  CLI::App* command = parent.add_subcommand(text.name, text.description);
  command->fallthrough();
  command->group(text.group);
  command->footer(fmt::format("Examples:\n{}\n", text.examples));
  command->callback([&context, run = std::move(run)] { context.action = run; });
  return command;
}

void add_scene_name(CLI::App& command, std::string& name) {
  add_value(command, "NAME", name, kind::text("NAME"), "the scene")->required();
}

void add_scene_options(CLI::App& command, client::SceneOptions& scene) {
  add_value(command, "--method", scene.method, kind::method(), "rcb, bands-x, bands-y or bands-z")
      ->capture_default_str();
  add_value(command, "--tolerance", scene.tolerance, kind::tolerance(), kToleranceHelp)->capture_default_str();
  add_value(command, "--axis-hysteresis", scene.axis_hysteresis, kind::number_from_one("H"), kHysteresisHelp)
      ->capture_default_str();
  add_value(command, "--cut-tolerance", scene.cut_tolerance, kind::number_between("E", 0, 1), kCutToleranceHelp)
      ->capture_default_str();
  add_value(command, "--policy", scene.policy, kind::policy(), kPolicyHelp)->capture_default_str();
  add_value(command, "--positions", scene.positions, kind::positions(), kPositionsHelp)->capture_default_str();
  add_list(command, "--part-sizes", scene.part_sizes, kind::positive_number("LIST"), kPartSizesHelp);
  command.add_flag("--replace", scene.replace, "drop a scene of that name first");
}

void add_deadline(CLI::App& command, double& seconds) {
  add_value(command, "--deadline", seconds, kind::deadline(), kDeadlineHelp)->capture_default_str();
}

void add_held(CLI::App& command, bool& held) {
  command.add_flag("--held", held,
                   "of the positions that the ranks hold, however old, rather than wait for the solver's next step "
                   "(scenes with --positions when-needed)");
}

Status check_endpoint(const Context& context) {
  if (context.endpoint.empty()) return {};
  if (context.endpoint.starts_with(client::kFilePrefix)) return {};  // the file is read when it is needed
  const auto endpoint = client::parse_endpoint(context.endpoint);
  if (endpoint) return {};
  const Status why = endpoint.status();
  return {Code::usage, why.message(), why.hint()};
}

namespace {

client::ConnectOptions connect_options(const std::string& endpoint) {
  client::ConnectOptions options;
  options.endpoint = endpoint;
  options.name = "rcbctl " RCB_VERSION;
  options.on_notice = note;
  options.on_wait = go_on_waiting;
  return options;
}

Result<client::Client> connect_as(const Context& context, bool outlive) {
  if (Status status = check_endpoint(context); !status) return status;
  catch_interrupts();
  client::ConnectOptions options = connect_options(context.endpoint);
  options.outlive = outlive;
  auto client = launch::connect_awaiting_restart(options);
  if (!client) return launch::explain_absence(context.endpoint, client.status());
  return client;
}

}  // namespace

Result<client::Client> connect(const Context& context) { return connect_as(context, false); }
Result<client::Client> connect_persistent(const Context& context) { return connect_as(context, true); }

Result<Session> Session::open(const Context& context, int ranks) {
  Session session;
  if (ranks == 0) {
    auto running = connect(context);
    if (running) {
      session.client = std::move(*running);
      return session;
    }
    if (running.status().code() != Code::unavailable) return running.status();
    if (interrupted()) return interruption("before a service was started");
    ranks = launch::default_ranks();
  }
  Progress progress(fmt::format("starting an embedded service of {} rank{}", ranks, ranks == 1 ? "" : "s"));
  auto embedded = launch::Embedded::start(ranks, [&progress](double seconds) { progress.seconds(seconds); });
  progress.clear();
  if (!embedded) return embedded.status();
  session.embedded.emplace(std::move(*embedded));
  catch_interrupts();  // again, since what the launcher does at Ctrl-C while it starts a service has taken the place
  client::ConnectOptions options = connect_options(session.embedded->endpoint());
  options.outlive = false;
  auto client = client::Client::connect(options);
  if (!client) return session.explain(client.status());
  session.client = std::move(*client);
  return session;
}

bool is_utf8(const std::string& text) {
  try {
    return !Json(text).dump().empty();
  } catch (const Json::type_error&) {
    return false;
  }
}

Result<Answer> ask_arrays(client::Client& client, const std::string& command, const Json& arguments,
                          double deadline_seconds) {
  for (const auto& [name, value] : arguments.items())
    if (value.is_string() && !is_utf8(value.get_ref<const std::string&>()))
      return Status(Code::usage, fmt::format("the {} '{}' is not UTF-8", name, text_of(value)),
                    "the service is told names in UTF-8 alone");
  std::optional<Progress> waiting;
  if (!Progress::any()) waiting.emplace(fmt::format("waiting for the answer to '{}'", command));
  auto reply = client.call(command, arguments.dump(), deadline_seconds);
  if (!reply) return reply.status();
  Json json = Json::parse(reply->json, nullptr, false);
  if (!json.is_object()) return Status(Code::protocol_error, "the answer to " + command + " is no JSON object");
  json.erase("arrays");
  return Answer{std::move(json), std::move(*reply)};
}

Result<Json> ask(client::Client& client, const std::string& command, const Json& arguments, double deadline_seconds) {
  auto answer = ask_arrays(client, command, arguments, deadline_seconds);
  if (!answer) return answer.status();
  fill_lists(answer->json, answer->reply);
  return std::move(answer->json);
}

Json tolerance_json(double tolerance) {
  if (std::isinf(tolerance)) return "inf";
  return tolerance;
}

Status show(const Context& context, const Json& document, const std::function<void()>& for_people) {
  if (context.json)
    print_json(document);
  else
    for_people();
  return {};
}

Status ask_and_show(const Context& context, const std::string& command, const Json& arguments,
                    const std::function<void(const Json& reply)>& for_people, double deadline_seconds) {
  auto client = connect(context);
  if (!client) return client.status();
  const auto reply = ask(*client, command, arguments, deadline_seconds);
  if (!reply) return reply.status();
  return show(context, *reply, [&] { for_people(*reply); });
}

}  // namespace rcb::cli
