#include "client/solvers/drive.hpp"

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

#include "client/lib/connect/endpoint.hpp"
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

// The numeric options as typed, not yet parsed.
struct TypedOptions {
  std::string points, steps, parts, tolerance, deadline;
  std::vector<std::string> numbers;
};

void declare(CLI::App& app, const Program& program, RunOptions& options, TypedOptions& typed) {
  const RunOptions& d = program.defaults;
  const auto number = [&app](const char* name, std::string& text, const std::string& fallback,
                             const std::string& help) {
    app.add_option(name, text, help)->type_name("NUMBER")->default_str(fallback);
  };
  number("--points", typed.points, fmt::format("{}", d.points), "material points, exactly this many");
  number("--steps", typed.steps, fmt::format("{}", d.steps), "steps after step 0; each is pushed to the service");
  number("--parts", typed.parts, fmt::format("{}", d.parts), "parts that the service cuts the points into");
  number("--tolerance", typed.tolerance, fmt::format("{}", d.tolerance),
         "load error at which the service repartitions; inf: never after step 0");
  app.add_option(
         "--policy", options.policy,
         "repartition at the tolerance or, with cost, once imbalance has cost more time than a repartition takes")
      ->check(CLI::IsMember({"tolerance", "cost"}))
      ->default_str(d.policy);
  add_positions_option(app, options.positions);
  app.add_option("--scene", options.scene, "name of the scene in the service; one of that name is replaced")
      ->type_name("NAME")
      ->default_str(d.scene);
  add_place_options(app, options.endpoint, options.trajectory);
  number("--deadline", typed.deadline, fmt::format("{}", d.deadline_seconds), "seconds that one push may take");
  add_outlive_option(app, options.outlive);
  app.add_flag("--no-service", options.no_service, "only the physics: nothing is pushed, no service is needed");
  app.add_flag("--json", options.json, "one JSON document on standard output instead of the summary");
  typed.numbers.resize(program.numbers.size());
  for (std::size_t k = 0; k < program.numbers.size(); ++k)
    app.add_option(program.numbers[k].name, typed.numbers[k], program.numbers[k].help)
        ->type_name("NUMBER")
        ->default_str(fmt::format("{}", *program.numbers[k].value))
        ->group("Physics");
  app.set_version_flag("--version", program.name + " " + program.version);
  app.footer(kFooter);
}

Status wrong(const std::string& option, const Status& why) {
  return {Code::usage, fmt::format("{}: {}", option, why.message()), why.hint()};
}

Status understand(const Program& program, const TypedOptions& typed, RunOptions& options) {
  const auto whole = [](const char* name, const std::string& text, std::int64_t low, std::int64_t high, auto& value) {
    if (text.empty()) return Status{};
    const auto parsed = parse_whole(text, low, high);
    if (!parsed) return wrong(name, parsed.status());
    value = static_cast<std::remove_reference_t<decltype(value)>>(*parsed);
    return Status{};
  };
  if (Status s = whole("--points", typed.points, 1, static_cast<std::int64_t>(kPointsMax), options.points); !s.ok())
    return s;
  if (Status s = whole("--steps", typed.steps, 0, kStepsMax, options.steps); !s.ok()) return s;
  if (Status s = whole("--parts", typed.parts, 1, kPartsMax, options.parts); !s.ok()) return s;
  const auto real = [](const std::string& name, const std::string& text, double& value) {
    if (text.empty()) return Status{};
    const auto parsed = parse_number(text);
    if (!parsed) return wrong(name, parsed.status());
    value = *parsed;
    return Status{};
  };
  if (Status s = real("--tolerance", typed.tolerance, options.tolerance); !s.ok()) return s;
  if (!(options.tolerance >= 0))
    return {Code::usage, fmt::format("--tolerance: {} is below 0", typed.tolerance), "give 0 or more, or inf"};
  if (Status s = real("--deadline", typed.deadline, options.deadline_seconds); !s.ok()) return s;
  if (!(options.deadline_seconds > 0 && options.deadline_seconds <= 3600))
    return {Code::usage, fmt::format("--deadline: {} is no time to wait", typed.deadline), "give up to 3600 seconds"};
  for (std::size_t k = 0; k < typed.numbers.size(); ++k)
    if (Status s = real(program.numbers[k].name, typed.numbers[k], *program.numbers[k].value); !s.ok()) return s;
  const auto endpoints = client::endpoints_to_try(options.endpoint);
  if (!options.no_service && endpoints.status().code() == Code::invalid_argument)
    return {Code::usage, endpoints.status().message(), endpoints.status().hint()};
  return {};
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
  if (!simulation) {
    const Status& why = simulation.status();
    // A scene that can't be built is due to the options.
    return why.code() == Code::invalid_argument ? Status(Code::usage, why.message(), why.hint()) : why;
  }
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
    if (!opened) return opened.status();
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
  for (int k = 1; k < argc; ++k)
    if (std::string_view(argv[k]) == "--json") options.json = true;  // must be known before anything can fail
  TypedOptions typed;
  CLI::App app(program.description, program.name);
  declare(app, program, options, typed);
  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& asked) {
    return app.exit(asked);
  } catch (const CLI::ParseError& error) {
    return fail(program, options.json, {Code::usage, error.what(), fmt::format("see {} --help", program.name)});
  }
  if (Status status = understand(program, typed, options); !status.ok()) return fail(program, options.json, status);

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

void add_place_options(CLI::App& app, std::string& endpoint, std::string& trajectory) {
  app.add_option("--endpoint", endpoint,
                 "where the service is: unix:PATH, HOST:PORT or file:PATH (default: RCBD_ENDPOINT, then this user's "
                 "socket, then 127.0.0.1:7470)")
      ->type_name("E");
  app.add_option("--trajectory", trajectory, "also write all positions to this .npy: (steps + 1, points, 3)")
      ->type_name("F.npy");
}

void add_positions_option(CLI::App& app, std::string& positions) {
  app.add_option(
         "--positions", positions,
         "when positions travel to the service: at every step, or when needed: a step is then counted here, and "
         "sent where new cuts are due or a question about positions waits")
      ->check(CLI::IsMember({"every-step", "when-needed"}))
      ->default_str(positions);
}

void add_outlive_option(CLI::App& app, bool& outlive) {
  app.add_flag("!--no-outlive", outlive, "end when the service has gone; else a step waits for it until its deadline");
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
  bool json = false;
  for (int k = 1; k < argc; ++k) json = json || std::string_view(argv[k]) == "--json";
  try {
    return run_command_line(program, argc, argv);
  } catch (const std::bad_alloc&) {
    return fail(program, json, {Code::too_large, "out of memory", "use fewer points"});
  } catch (const std::exception& error) {
    return fail(program, json, {Code::internal, error.what()});
  }
}

}  // namespace rcb::solvers
