#include "client/solvers/drive.hpp"

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <memory>
#include <new>
#include <string_view>
#include <utility>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <unistd.h>

#include "common/base/clock.hpp"
#include "common/base/signals.hpp"

namespace rcb::solvers {
namespace {

constexpr std::int64_t kStepsMax = 10'000'000;
constexpr std::int64_t kPartsMax = 1'048'576;

volatile std::sig_atomic_t interrupt_seen = 0;

// The first signal makes the step loop end; a second one ends the program at once.
void catch_interrupts() {
  struct sigaction action {};
  action.sa_handler = [](int) { interrupt_seen = 1; };
  action.sa_flags = static_cast<int>(SA_RESETHAND | SA_RESTART);
  handle_unless_ignored(SIGINT, action);
  handle_unless_ignored(SIGTERM, action);
}

// A progress line, rewritten at every step; only on a terminal.
class Progress {
 public:
  explicit Progress(std::int64_t steps) : steps_(steps), on_(isatty(STDERR_FILENO) == 1) {}
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  ~Progress() {
    if (on_) fmt::print(stderr, "\r\x1b[K");
  }
  void show(const RunRecord& record) {
    if (!on_) return;
    std::string text = fmt::format("step {} of {}", record.steps_done, steps_);
    if (!record.reports.empty())
      text += fmt::format("   error {:.4f}   repartitions {}", record.reports.back().error, record.repartitions());
    fmt::print(stderr, "\r\x1b[K{}", text);
    std::fflush(stderr);
  }

 private:
  std::int64_t steps_;
  bool on_;
};

// Of an option that can be given in any spelling of a number. wrong: what is wrong with its value; empty if nothing is.
template <typename T, typename Wrong>
void add_number(CLI::App& app, const std::string& name, T& value, const std::string& help, const Wrong& wrong) {
  app.add_option(name, value, help)
      ->type_name("NUMBER")
      ->default_str(fmt::format("{}", value))
      ->transform(CLI::Validator(wrong, ""));
}

auto whole(std::int64_t low, std::int64_t high) {
  return [low, high](std::string& text) {
    const auto value = parse_whole(text, low, high);
    if (value) text = std::to_string(*value);
    return value.status().message();
  };
}

// What is wrong with what the user wants ends the program as wrong usage.
Status as_usage(const Status& why) {
  return why.code() == Code::invalid_argument ? Status(Code::usage, why.message(), why.hint()) : why;
}

int fail(const Program& program, bool json, const Status& status) { return tell_failure(program.name, json, status); }

struct Service {
  client::Client client;
  client::Scene scene;
};

Result<std::unique_ptr<Service>> open_service(const Program& program, const RunOptions& options) {
  client::ConnectOptions connect;
  connect.endpoint = options.endpoint;
  connect.name = program.name;
  connect.outlive = options.outlive;
  connect.on_notice = [name = program.name](const std::string& text) { say_notice(name, text); };
  auto client = client::Client::connect(connect);
  if (!client) return client.status();
  const client::SceneOptions create{.parts = options.parts,
                                    .tolerance = options.tolerance,
                                    .policy = options.policy,
                                    .positions = options.positions,
                                    .replace = true};
  if (Status status = client->create_scene(options.scene, create); !status.ok()) return status;
  auto scene = client->open_scene(options.scene);
  if (!scene) return scene.status();
  return std::unique_ptr<Service>(new Service{std::move(*client), std::move(*scene)});
}

// Runs the solver, once the command line has been parsed.
Status run(const Program& program, const RunOptions& options, double& interval, RunRecord& record) {
  auto simulation = program.build(options.points);
  if (!simulation) return as_usage(simulation.status());
  interval = simulation->interval;

  std::unique_ptr<io::TrajectoryWriter> trajectory;
  if (!options.trajectory.empty()) {
    auto created = io::TrajectoryWriter::create(options.trajectory, options.points, 3);
    if (!created) return created.status();
    trajectory = std::move(*created);
  }
  std::unique_ptr<Service> service;
  if (!options.no_service) {
    auto opened = open_service(program, options);
    if (!opened) return as_usage(opened.status());
    service = std::move(*opened);
  }

  StepLoop loop;
  loop.trajectory = trajectory.get();
  loop.interrupted = [] { return interrupt_seen != 0; };
  if (service)
    loop.push = [&](std::int64_t step, const client::Positions& positions,
                    std::optional<double> seconds) -> Result<client::StepReport> {
      client::StepOptions push;
      push.step = step;
      push.step_seconds = seconds;
      push.deadline_seconds = options.deadline_seconds;
      auto result = service->scene.step(positions, push);
      if (!result) return result.status();
      return std::move(result->report);
    };
  Progress progress(options.steps);
  loop.after_step = [&](const RunRecord& so_far) { progress.show(so_far); };
  if (Status status = run_steps(*simulation, options.steps, loop, SteadyClock{}, record); !status.ok()) return status;
  return trajectory ? trajectory->close() : Status{};
}

int run_command_line(const Program& program, int argc, char** argv) {
  RunOptions options = program.defaults;
  options.json = asks_for_json(argc, argv);  // must be known before anything can fail
  CLI::App app(program.description, program.name);
  add_run_options(app, options);
  app.add_flag("--no-service", options.no_service, "only the physics: nothing is pushed, no service is needed");
  add_numbers(app, program.numbers);
  app.set_version_flag("--version", program.name + " " + program.version);
  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& asked) {
    return app.exit(asked);
  } catch (const CLI::ParseError& error) {
    return fail(program, options.json, {Code::usage, error.what(), fmt::format("see {} --help", program.name)});
  }

  catch_interrupts();
  double interval = 0;
  RunRecord record;
  if (Status status = run(program, options, interval, record); !status.ok()) return fail(program, options.json, status);
  fmt::print("{}\n",
             options.json ? json_document(program, options, record) : summary(program, options, interval, record));
  if (Status status = flush_output(); !status.ok()) return fail(program, false, status);
  return 0;
}

}  // namespace

Status flush_output() {
  if (std::fflush(stdout) == 0 && std::ferror(stdout) == 0) return {};
  return {Code::io_error, fmt::format("standard output can't be written: {}", std::strerror(errno))};
}

int tell_failure(const std::string& program, bool json, const Status& status) {
  if (json) fmt::print("{}\n", failure_document(status));
  fmt::print(stderr, "{}: {}{}{}\n", program, status.message(),
             status.hint().empty() ? "" : "\n  hint: ", status.hint());
  return exit_code(status.code());
}

void add_run_options(CLI::App& app, RunOptions& options) {
  add_number(app, "--points", options.points, "material points, exactly this many",
             whole(1, static_cast<std::int64_t>(kPointsMax)));
  add_number(app, "--steps", options.steps, "steps after step 0", whole(0, kStepsMax));
  add_number(app, "--parts", options.parts, "parts that the service cuts the points into", whole(1, kPartsMax));
  add_number(app, "--tolerance", options.tolerance,
             "load error at which the service repartitions; inf: never after step 0", [](std::string& text) {
               const auto value = parse_number(text);
               if (!value) return value.status().message();
               return *value >= 0 ? std::string() : fmt::format("{} is below 0; give 0 or more, or inf", text);
             });
  app.add_option(
         "--policy", options.policy,
         "repartition at the tolerance or, with cost, once imbalance has cost more time than a repartition takes")
      ->check(CLI::IsMember({"tolerance", "cost"}))
      ->capture_default_str();
  app.add_option(
         "--positions", options.positions,
         "when positions travel to the service: at every step, or when needed: a step is then counted here, and "
         "sent where new cuts are due or a question about positions waits")
      ->check(CLI::IsMember({"every-step", "when-needed"}))
      ->capture_default_str();
  app.add_option("--scene", options.scene, "name of the scene in the service; one of that name is replaced")
      ->type_name("NAME")
      ->capture_default_str();
  app.add_option("--endpoint", options.endpoint,
                 "where the service is: unix:PATH, HOST:PORT or file:PATH (default: RCBD_ENDPOINT, then this user's "
                 "socket, then 127.0.0.1:7470)")
      ->type_name("E");
  app.add_option("--trajectory", options.trajectory, "also write all positions to this .npy: (steps + 1, points, 3)")
      ->type_name("F.npy");
  add_number(app, "--deadline", options.deadline_seconds, "seconds that one push may take", [](std::string& text) {
    const auto value = parse_number(text);
    if (!value) return value.status().message();
    return *value > 0 && *value <= 3600 ? "" : fmt::format("{} is no time to wait; give up to 3600 seconds", text);
  });
  app.add_flag("!--no-outlive", options.outlive,
               "end when the service has gone; else a step waits for it until its deadline");
  app.add_flag("--json", options.json, "one JSON document on standard output instead of the summary");
  app.footer(
      "Exit codes: 0 done, 1 the service or the physics failed, 2 wrong usage, 3 no service reachable,\n"
      "4 not authorised, 5 a deadline passed.\n"
      "Start a service first with: rcbctl up");
}

void add_numbers(CLI::App& app, const std::vector<NumberOption>& numbers) {
  for (const NumberOption& one : numbers) {
    add_number(app, one.name, *one.value, one.help,
               [](std::string& text) { return parse_number(text).status().message(); });
    app.get_option(one.name)->group("Physics");
  }
}

bool asks_for_json(int argc, char** argv) {
  return std::any_of(argv, argv + argc, [](const char* word) { return std::string_view(word) == "--json"; });
}

void say_notice(const std::string& program, const std::string& text) {
  fmt::print(stderr, "{}{}: {}\n", isatty(STDERR_FILENO) == 1 ? "\r\x1b[K" : "", program, text);
}

Result<double> parse_number(const std::string& text) {
  std::string_view digits = text;
  if (digits.starts_with('+')) digits.remove_prefix(1);
  double value = 0;
  const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
  if (error != std::errc{} || end != digits.data() + digits.size() || std::isnan(value))
    return Status(Code::invalid_argument, fmt::format("\"{}\" is not a number", text), "write it like 0.1 or 1e3");
  return value;
}

Result<std::int64_t> parse_whole(const std::string& text, std::int64_t low, std::int64_t high) {
  const auto value = parse_number(text);
  if (!value) return value.status();
  // Doubles represent all integers up to 2^53; `high` is below that.
  if (!(*value >= static_cast<double>(low) && *value <= static_cast<double>(high)) || *value != std::floor(*value))
    return Status(Code::invalid_argument, fmt::format("{} is not a whole number from {} to {}", text, low, high));
  return static_cast<std::int64_t>(*value);
}

int run_program(const Program& program, int argc, char** argv) {
  const bool json = asks_for_json(argc, argv);
  try {
    return run_command_line(program, argc, argv);
  } catch (const std::bad_alloc&) {
    return fail(program, json, {Code::too_large, "out of memory", "use fewer points"});
  } catch (const std::exception& error) {
    return fail(program, json, {Code::internal, error.what()});
  }
}

}  // namespace rcb::solvers
