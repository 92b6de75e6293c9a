// slope_mpi: the submarine slope on several processes, each with a seat of the scene that the service partitions. A
// process holds only the points of its own parts; each step tells which of them it hands over to whom.
#include <algorithm>
#include <array>
#include <cstdio>
#include <memory>
#include <numeric>
#include <string>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <mpi.h>
#include <nlohmann/json.hpp>

#include "client/lib/client.hpp"
#include "client/solvers/drive.hpp"
#include "client/solvers/mpi/cores.hpp"
#include "client/solvers/scenes.hpp"
#include "common/base/clock.hpp"
#include "common/io/points.hpp"
#include "common/layout/layout.hpp"

namespace rcb::solvers {
namespace {

using nlohmann::json;

struct Options {
  SlopeOptions slope;
  std::int64_t steps = 200;
  int parts = 8;
  double tolerance = 0.1;
  std::string positions = "every-step";
  std::string scene = "slope";
  std::string endpoint;
  std::string trajectory;
  double deadline_seconds = 60;
  bool outlive = true;
  bool check = false;
  bool json = false;
};

struct Record : RunRecord {
  std::vector<std::uint64_t> held;  // points by process, after the last step
  std::uint64_t handed_over = 0;    // points, by this process
  double seconds_exchange = 0;
};

// Reads numbers as the other solvers do: 8.0 and 1e6 are whole, a tolerance may be inf.
CLI::Validator whole(std::int64_t low, std::int64_t high) {
  const auto read = [low, high](std::string& text) {
    const auto value = parse_whole(text, low, high);
    if (value) text = std::to_string(*value);
    return value ? std::string() : value.status().message();
  };
  return {read, ""};
}

CLI::Validator tolerance() {
  const auto read = [](std::string& text) {
    const auto value = parse_number(text);
    if (!value) return value.status().message();
    return *value >= 0 ? std::string() : fmt::format("{} is below 0; give 0 or more, or inf", text);
  };
  return {read, ""};
}

void declare(CLI::App& app, Options& o) {
  app.option_defaults()->always_capture_default();
  app.add_option("--points", o.slope.points, "material points, of all processes")->transform(whole(1, 100'000'000));
  app.add_option("--steps", o.steps, "steps after step 0")->transform(whole(0, 10'000'000));
  app.add_option("--parts", o.parts, "parts; process k of M keeps those from kP/M to (k+1)P/M")
      ->transform(whole(1, 1'048'576));
  app.add_option("--tolerance", o.tolerance, "load error at which the service repartitions; inf: never after step 0")
      ->check(tolerance());
  add_positions_option(app, o.positions);
  app.add_option("--scene", o.scene, "name of the scene; one of that name is replaced")->type_name("NAME");
  add_place_options(app, o.endpoint, o.trajectory);
  app.add_option("--deadline", o.deadline_seconds, "seconds that one push may take")->check(CLI::Range(1e-3, 3600.0));
  add_outlive_option(app, o.outlive);
  app.add_flag("--check", o.check,
               "after every step ask the service which process each point belongs to, and fail where another holds it");
  app.add_flag("--json", o.json, "one JSON document on standard output instead of the summary");
  app.add_option("--unit-weight", o.slope.unit_weight, "of the sediment, submerged, N/m^3")->group("Physics");
  app.add_option("--friction-angle", o.slope.friction_angle, "of the sediment, degrees")->group("Physics");
  app.add_option("--bed-friction", o.slope.bed_friction, "between sediment and bed, degrees")->group("Physics");
  app.add_option("--youngs-modulus", o.slope.youngs_modulus, "of the upper layer, Pa")->group("Physics");
  app.add_option("--poissons-ratio", o.slope.poissons_ratio, "-1 to 0.5")->group("Physics");
  app.add_option("--interval", o.slope.interval, "time of a step, s")->group("Physics");

  app.set_version_flag("--version", std::string("slope_mpi ") + RCB_VERSION);
}

// Makes the whole slope and keeps this process's block of points; the first push tells where they belong.
Result<Mpm> make_share(const Options& options, int rank, int size) {
  auto whole = make_slope(options.slope);
  if (!whole) return whole.status();
  Mpm mpm = std::move(whole->mpm);
  std::vector<std::size_t> others(mpm.size());
  std::iota(others.begin(), others.end(), std::size_t{0});
  others.erase(others.begin() + static_cast<std::ptrdiff_t>(layout::row_begin(rank, mpm.size(), size)),
               others.begin() + static_cast<std::ptrdiff_t>(layout::row_begin(rank + 1, mpm.size(), size)));
  mpm.exchange(others, {});
  return mpm;
}

struct Seat {
  client::Client client;
  client::Scene scene;
};

Result<std::unique_ptr<Seat>> open_scene(const Options& options, MpiCores& cores) {
  client::ConnectOptions connect;
  connect.endpoint = options.endpoint;
  connect.name = fmt::format("slope_mpi {} of {}", cores.rank(), cores.size());
  connect.outlive = options.outlive;
  if (cores.rank() == 0)  // all processes wait for the same service
    connect.on_notice = [](const std::string& text) { say_notice("slope_mpi", text); };
  auto client = client::Client::connect(connect);
  Status status = client.status();
  if (status && cores.rank() == 0)
    status = client->create_scene(
        options.scene,
        {.parts = options.parts, .tolerance = options.tolerance, .positions = options.positions, .replace = true});
  if (Status all = cores.agree(status); !all) return all;
  auto scene = client->open_scene(options.scene, {.seat = cores.rank(), .seats = cores.size()});
  if (Status all = cores.agree(scene.status()); !all) return all;
  return std::unique_ptr<Seat>(new Seat{std::move(*client), std::move(*scene)});
}

// Compares the service's list of this process's points with those held here. Not possible if another client has changed
// the partition since the step of `report`, or if the service was lost.
Status check_held(client::Client& client, const Options& options, const client::StepReport& report,
                  const MpiCores& cores, const Mpm& mpm) {
  const auto reply = client.call("assign", json{{"scene", options.scene}}.dump(), options.deadline_seconds);
  if (options.outlive && reply.status().code() == Code::not_found) return {};  // the service was lost since the step
  if (!reply) return reply.status();
  if (json::parse(reply->json).value("epoch", std::uint64_t{0}) != report.epoch) return {};
  const client::Array* id = reply->find("id");
  const client::Array* part = reply->find("part");
  if (id == nullptr || part == nullptr) return {Code::protocol_error, "answer to 'assign': no arrays"};
  std::vector<std::int64_t> expected;
  for (std::size_t k = 0; k < id->i8().size(); ++k)
    if (layout::rank_of_part(part->i4()[k], report.parts, cores.size()) == cores.rank())
      expected.push_back(id->i8()[k]);
  std::vector<std::int64_t> held(mpm.id().begin(), mpm.id().end());
  std::sort(held.begin(), held.end());
  if (held == expected) return {};
  return {Code::internal, fmt::format("process {} holds {} points, of its parts are {}, or others", cores.rank(),
                                      held.size(), expected.size())};
}

Status push(Seat& seat, const Options& options, MpiCores& cores, Mpm& mpm, std::int64_t step, double advanced,
            const Clock& clock, Record& record) {
  const std::array<const double*, 3> axes{mpm.position(0).data(), mpm.position(1).data(), mpm.position(2).data()};
  client::StepOptions with;
  with.step = step;
  with.ids = mpm.id();
  if (step > 0) with.step_seconds = advanced;
  with.deadline_seconds = options.deadline_seconds;
  const double begin = clock.seconds();
  const auto news = seat.scene.step(client::Positions::axes(axes, mpm.size()), with);
  const double answered = clock.seconds();
  record.seconds_service += answered - begin;
  if (Status all = cores.agree(news.status()); !all)
    return {all.code(), fmt::format("step {}: {}", step, all.message()), all.hint()};
  cores.hand_over(mpm, news->leaving);
  record.seconds_exchange += clock.seconds() - answered;
  record.handed_over += news->leaving.size();
  record.reports.push_back(news->report);
  return options.check ? cores.agree(check_held(seat.client, options, news->report, cores, mpm)) : Status{};
}

Status run(const Options& options, MpiCores& cores, Record& record) {
  const SteadyClock clock;
  auto share = make_share(options, cores.rank(), cores.size());
  if (Status all = cores.agree(share.status()); !all) return all;
  Mpm mpm = std::move(*share);
  std::unique_ptr<io::TrajectoryWriter> trajectory;
  Status created;
  if (!options.trajectory.empty() && cores.rank() == 0) {
    auto writer = io::TrajectoryWriter::create(options.trajectory, options.slope.points, 3);
    created = writer.status();
    if (writer) trajectory = std::move(*writer);
  }
  if (Status all = cores.agree(created); !all) return all;
  auto seat = open_scene(options, cores);
  if (!seat) return seat.status();
  for (std::int64_t step = 0; step <= options.steps; ++step) {
    const double start = clock.seconds();
    if (step > 0)
      if (Status status = mpm.advance(options.slope.interval, &cores); !status) return status;
    const double advanced = clock.seconds() - start;
    record.seconds_physics += advanced;
    record.physics.end = cores.sum(mpm.balance());
    if (step == 0) record.physics.start = record.physics.end;
    if (!options.trajectory.empty()) {
      const auto frame = cores.gather_positions(mpm, options.slope.points);
      if (Status all = cores.agree(trajectory ? trajectory->append(frame) : Status{}); !all) return all;
    }
    if (Status status = push(**seat, options, cores, mpm, step, advanced, clock, record); !status) return status;
    record.held = cores.gather(mpm.size());
  }
  record.substeps = mpm.substeps();
  return cores.agree(trajectory ? trajectory->close() : Status{});
}

void say_end(const Options& options, const MpiCores& cores, const Record& record, std::uint64_t handed_over) {
  const Balance& start = record.physics.start;
  const Balance& end = record.physics.end;
  if (!options.json) {
    fmt::print(
        "slope_mpi: {} points on {} processes, {} steps of {:g} s in {} substeps, scene {} in {}\n"
        "  repartitions   {} (the first partition included)\n"
        "  handed over    {} points\n"
        "  wall clock     {:.3g} s physics, {:.3g} s service, {:.3g} s handing over\n",
        options.slope.points, cores.size(), options.steps, options.slope.interval, record.substeps, options.scene,
        parts_text(options.parts, record.reports), record.repartitions(), handed_over, record.seconds_physics,
        record.seconds_service, record.seconds_exchange);
    return;
  }
  json reports = json::array();
  for (const client::StepReport& report : record.reports) reports.push_back(json::parse(report.json));
  const json document{{"scene", options.scene},
                      {"solver", "slope_mpi"},
                      {"members", cores.size()},
                      {"points", options.slope.points},
                      {"steps", options.steps},
                      {"parts", options.parts},
                      {"positions", options.positions},
                      {"repartitions", record.repartitions()},
                      {"reports", std::move(reports)},
                      {"held", record.held},
                      {"handed_over", handed_over},
                      {"checked", options.check},
                      {"substeps", record.substeps},
                      {"momentum", {{"start", start.momentum}, {"end", end.momentum}}},
                      {"energy", {{"start", start.energy()}, {"end", end.energy()}}},
                      {"seconds",
                       {{"physics", record.seconds_physics},
                        {"service", record.seconds_service},
                        {"exchange", record.seconds_exchange}}}};
  fmt::print("{}\n", document.dump());
}

int run_on(MpiCores& cores, int argc, char** argv) {
  CLI::App app(
      "The submarine slope of `slope` on several processes. Each has a seat of the scene and holds the points of its\n"
      "own parts; each step tells which of them it hands over to whom:\n"
      "  mpirun --oversubscribe -n 4 slope_mpi        (as root also --allow-run-as-root)",
      "slope_mpi");
  app.footer(kFooter);
  Options options;
  declare(app, options);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    if (cores.rank() != 0) return error.get_exit_code() == 0 ? 0 : exit_code(Code::usage);
    if (error.get_exit_code() == 0) return app.exit(error);
    return tell_failure("slope_mpi", options.json, {Code::usage, error.what(), "see slope_mpi --help"});
  }
  Record record;
  Status status = run(options, cores, record);
  const auto handed_over = cores.gather(record.handed_over);
  if (status.ok() && cores.rank() == 0) {
    say_end(options, cores, record, std::accumulate(handed_over.begin(), handed_over.end(), std::uint64_t{0}));
    status = flush_output();
  }
  if (status.ok()) return 0;
  // What can't be done at all is due to the options.
  if (status.code() == Code::invalid_argument) status = {Code::usage, status.message(), status.hint()};
  return cores.rank() == 0 ? tell_failure("slope_mpi", options.json, status) : exit_code(status.code());
}

}  // namespace
}  // namespace rcb::solvers

int main(int argc, char** argv) {
  MPI_Init(&argc, &argv);
  int code = 1;
  {
    rcb::solvers::MpiCores cores(MPI_COMM_WORLD);
    try {
      code = rcb::solvers::run_on(cores, argc, argv);
    } catch (const std::exception& error) {  // if one process can't go on, none can
      std::fprintf(stderr, "slope_mpi: process %d: %s\n", cores.rank(), error.what());
      MPI_Abort(MPI_COMM_WORLD, 1);
    }
  }
  MPI_Finalize();
  return code;
}
