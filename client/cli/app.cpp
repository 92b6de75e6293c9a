#include "client/cli/app.hpp"

#include <cmath>

#include <fmt/format.h>

#include "client/cli/output.hpp"
#include "common/wire/limits.hpp"

namespace rcb::cli {
namespace {

// CLI11 wants an empty text for a value that passes.
CLI::Validator number_check(const std::string& wanted, std::function<bool(double)> good) {
  return CLI::Validator(
      [wanted, good](std::string& text) {
        double value = 0;
        if (CLI::detail::lexical_cast(text, value) && good(value)) return std::string();
        return fmt::format("{} is not {}", text, wanted);
      },
      "");
}

}  // namespace

CLI::App* add_command(CLI::App& parent, Context& context, const CommandText& text, std::function<Status()> run) {
  CLI::App* command = parent.add_subcommand(text.name, text.description);
  command->fallthrough();
  command->footer(fmt::format("Examples:\n{}\n", text.examples));
  command->callback([&context, run = std::move(run)] { context.action = run; });
  return command;
}

CLI::Validator positive_number() {
  return number_check("a number above 0", [](double v) { return std::isfinite(v) && v > 0; });
}

CLI::Validator number_from_zero() {
  return number_check("a number of at least 0", [](double v) { return std::isfinite(v) && v >= 0; });
}

CLI::Validator tolerance_number() {
  return number_check("a number of at least 0, or inf", [](double v) { return v >= 0; });
}

CLI::Validator hysteresis_number() {
  return number_check("a number of at least 1", [](double v) { return std::isfinite(v) && v >= 1; });
}

CLI::Validator part_count() {
  return number_check(fmt::format("a whole number of 1 to {}", wire::kPartsMax), [](double v) {
    return v >= 1 && v <= static_cast<double>(wire::kPartsMax) && std::trunc(v) == v;
  });
}

CLI::Validator scene_policy() { return CLI::IsMember({"tolerance", "cost"}); }

CLI::Validator scene_recut() { return CLI::IsMember({"all", "subtree"}); }

CLI::Validator scene_method() { return CLI::IsMember({"rcb", "bands-x", "bands-y", "bands-z"}); }

Result<client::Client> connect(const Context& context) {
  auto client = launch::reach(context.endpoint, "rcbctl " RCB_VERSION);
  if (!client) return launch::explain_absence(context.endpoint, client.status());
  return client;
}

Result<Session> Session::open(const Context& context, int ranks) {
  Session session;
  if (ranks == 0) {
    auto running = connect(context);
    if (running) {
      session.client = std::move(*running);
      return session;
    }
    if (running.status().code() != Code::unavailable) return running.status();
    ranks = launch::default_ranks();
  }
  Progress progress(fmt::format("starting an embedded service of {} rank{}", ranks, ranks == 1 ? "" : "s"));
  auto embedded = launch::Embedded::start(ranks, [&progress](double seconds) { progress.seconds(seconds); });
  progress.clear();
  if (!embedded) return embedded.status();
  session.embedded.emplace(std::move(*embedded));
  auto client = launch::reach(session.embedded->endpoint(), "rcbctl " RCB_VERSION);
  if (!client) return session.explain(client.status());
  session.client = std::move(*client);
  return session;
}

Result<Answer> ask_arrays(client::Client& client, const std::string& command, const Json& arguments,
                          double deadline_seconds) {
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
  return std::move(answer->json);
}

Json tolerance_json(double tolerance) {
  if (std::isinf(tolerance)) return "inf";
  return tolerance;
}

}  // namespace rcb::cli
