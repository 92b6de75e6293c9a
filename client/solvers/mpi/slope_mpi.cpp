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
#include "client/solvers/mpi/summary.hpp"
#include "client/solvers/scenes.hpp"
#include "common/base/clock.hpp"
#include "common/io/points.hpp"
#include "common/layout/layout.hpp"

namespace rcb::solvers {
namespace {

// Makes the whole slope and keeps this process's block of points; the first push tells where they belong.
Result<Mpm> make_share(const MpiOptions& options, int rank, int size) {
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

Result<std::unique_ptr<Seat>> open_scene(const MpiOptions& options, MpiCores& cores) {
  client::ConnectOptions connect;
  connect.endpoint = options.endpoint;
  connect.name = fmt::format("slope_mpi {} of {}", cores.rank(), cores.size());
  connect.outlive = options.outlive;
  if (cores.rank() == 0)  // all processes wait for the same service
    connect.on_notice = [](const std::string& text) { say_notice("slope_mpi", text); };
  auto client = client::Client::connect(connect);
  Status status = client.status();
  if (status && cores.rank() == 0)
    status = client->create_scene(options.scene, {.parts = options.parts,
                                                  .method = options.method,
                                                  .tolerance = options.tolerance,
                                                  .policy = options.policy,
                                                  .positions = options.positions,
                                                  .replace = true});
  if (Status all = cores.agree(status); !all) return all;
  auto scene = client->open_scene(options.scene, {.seat = cores.rank(), .seats = cores.size()});
  if (Status all = cores.agree(scene.status()); !all) return all;
  return std::unique_ptr<Seat>(new Seat{std::move(*client), std::move(*scene)});
}

// Compares the service's list of this process's points with those held here. Not possible if another client has changed
// the partition since the step of `report`, if the ranks hold an older step, or if the service was lost.
Status check_held(client::Client& client, const MpiOptions& options, const client::StepReport& report,
                  const MpiCores& cores, const Mpm& mpm) {
  const auto reply = client.call("assign", nlohmann::json{{"scene", options.scene}}.dump(), options.deadline_seconds);
  if (options.outlive && reply.status().code() == Code::not_found) return {};  // the service was lost since the step
  if (!reply) return reply.status();
  const auto answer = nlohmann::json::parse(reply->json);
  if (answer.value("epoch", std::uint64_t{0}) != report.epoch) return {};
  if (answer.value("positions_step", report.step) != report.step) return {};
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

Status push(Seat& seat, const MpiOptions& options, MpiCores& cores, Mpm& mpm, std::int64_t step, MpiRecord& record) {
  Work& work = cores.work();
  const std::array<const double*, 3> axes{mpm.position(0).data(), mpm.position(1).data(), mpm.position(2).data()};
  client::StepOptions with;
  with.step = step;
  with.ids = mpm.id();
  if (step > 0) with.step_seconds = work.computing;
  with.send = step == options.steps;  // rcbctl then answers for the end of the run
  with.deadline_seconds = options.deadline_seconds;
  const SteadyClock clock;
  const double begin = clock.seconds();
  const auto news = seat.scene.step(client::Positions::axes(axes, mpm.size()), with);
  work.service = clock.seconds() - begin;
  if (Status all = cores.agree(news.status()); !all)
    return {all.code(), fmt::format("step {}: {}", step, all.message()), all.hint()};
  const double before = cores.computing();
  cores.hand_over(mpm, news->leaving);
  work.computing += cores.computing() - before;
  record.reports.push_back(news->report);
  return options.check ? cores.agree(check_held(seat.client, options, news->report, cores, mpm)) : Status{};
}

Status run(const MpiOptions& options, MpiCores& cores, MpiRecord& record) {
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
  record.physics.start = cores.sum(mpm.balance());
  const SteadyClock clock;
  for (std::int64_t step = 0; step <= options.steps; ++step) {
    Work& work = cores.work() = {};
    const double begin = clock.seconds(), before = cores.computing();
    if (step > 0)
      if (Status status = mpm.advance(options.slope.interval, &cores); !status) return status;
    work.computing = cores.computing() - before;
    if (!options.trajectory.empty()) {
      const auto frame = cores.gather_positions(mpm, options.slope.points);
      if (Status all = cores.agree(trajectory ? trajectory->append(frame) : Status{}); !all) return all;
    }
    if (Status status = push(**seat, options, cores, mpm, step, record); !status) return status;
    work.wall = clock.seconds() - begin;
    record.work.push_back(work);
  }
  record.physics.end = cores.sum(mpm.balance());
  record.held = cores.gather(mpm.size());
  record.sum = cores.sum(record.work);
  record.largest = cores.largest(record.work);
  record.substeps = mpm.substeps();
  return cores.agree(trajectory ? trajectory->close() : Status{});
}

int run_on(MpiCores& cores, int argc, char** argv) {
  CLI::App app(
      "The submarine slope of `slope` on several processes. Each has a seat of the scene and holds the points of its\n"
      "own parts, process k of M those of the parts from kP/M to (k+1)P/M; each step tells which of them it hands "
      "over\n"
      "to whom:\n"
      "  mpirun --oversubscribe -n 4 slope_mpi        (as root also --allow-run-as-root)",
      "slope_mpi");
  MpiOptions options;
  options.points = options.slope.points;
  options.steps = 200;
  options.positions = "when-needed";
  options.scene = "slope";
  options.json = asks_for_json(argc, argv);
  add_run_options(app, options);
  app.add_option("--method", options.method, "how the service divides: by RCB, or into bands across one axis")
      ->check(CLI::IsMember({"rcb", "bands-x", "bands-y", "bands-z"}))
      ->capture_default_str();
  app.add_flag("--check", options.check,
               "after each step that was sent ask the service which process each point belongs to, and fail where "
               "another holds it");
  add_numbers(app, slope_numbers(options.slope));
  app.set_version_flag("--version", std::string("slope_mpi ") + RCB_VERSION);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    if (cores.rank() != 0) return error.get_exit_code() == 0 ? 0 : exit_code(Code::usage);
    if (error.get_exit_code() == 0) return app.exit(error);
    return tell_failure("slope_mpi", options.json, {Code::usage, error.what(), "see slope_mpi --help"});
  }
  options.slope.points = options.points;
  MpiRecord record;
  Status status = run(options, cores, record);
  if (status.ok() && cores.rank() == 0) {
    fmt::print("{}\n",
               options.json ? json_document(options, cores.size(), record) : summary(options, cores.size(), record));
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
