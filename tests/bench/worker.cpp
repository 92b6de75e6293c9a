#include "tests/bench/worker.hpp"

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <fstream>

#include <fmt/format.h>
#include <sys/prctl.h>

#include "server/ranks/mpi_session.hpp"
#include "tests/bench/measure.hpp"
#include "tests/bench/plan.hpp"
#include "tests/bench/rows.hpp"
#include "tests/bench/scenes.hpp"
#ifdef RCB_BENCH_ZOLTAN2
#include "tests/bench/peers/multijagged.hpp"
#endif

namespace rcb::bench {
namespace {

constexpr unsigned kFinishSeconds = 30;

// Collective.
Status run_static_cells(comm::Comm& comm, const Plan& plan, const std::string& rows_path) {
  std::ofstream rows;
  if (comm.rank() == 0) rows.open(rows_path);
  if (!comm::agree(comm, !rows.fail())) return {Code::io_error, rows_path + ": can't be written"};
  particles::ParticleSet points;
  const Cell* made = nullptr;
  const auto rank = static_cast<std::uint64_t>(comm.rank());
  const auto ranks = static_cast<std::uint64_t>(comm.size());
  for (const Cell& cell : plan.cells) {
    const SceneKind* kind = find_scene_kind(cell.scene);
    if (kind == nullptr) return {Code::not_found, "no scene " + cell.scene};
    if (comm.rank() == 0)
      fmt::print(stderr, "ranks {}: {}, {} points, {} parts\n", ranks, cell.scene, cell.n, cell.parts);
    if (made == nullptr || made->scene != cell.scene || made->n != cell.n) {
      points = {};
      points = make_rows(*kind, cell.n, cell.n * rank / ranks, cell.n * (rank + 1) / ranks);
      made = &cell;
    }
    // Made anew for each cell, so that none keeps memory of another's.
    Contenders contenders = make_contenders(comm, plan.wish);
    std::erase_if(contenders, [&](const auto& contender) {
      return std::ranges::any_of(plan.skips, [&](const Skip& skip) {
        return skip == Skip{cell, contender->setting().tool, contender->setting().method};
      });
    });
    const auto tell_turn = [&](const Setting& setting) {
      if (comm.rank() == 0) rows << Json{{"begun", json_of(Skip{cell, setting.tool, setting.method})}} << std::endl;
    };
    const auto measured =
        measure(comm, Problem{points.view(), cell.n, cell.parts}, contenders, {plan.repeats, plan.memory, tell_turn});
    if (comm.rank() != 0) continue;
    for (const auto& row : make_rows_json(cell, kind->dims, comm.size(), measured)) rows << row << "\n";
    rows.flush();
  }
  if (comm.rank() == 0) rows.close();
  if (!comm::agree(comm, !rows.fail())) return {Code::io_error, rows_path + ": can't be written"};
  return {};
}

}  // namespace

Contenders make_contenders(comm::Comm& comm, const Wish& wish) {
  Contenders all;
  add_rcbd(comm, wish, all);
  add_floor(wish, all);
#ifdef RCB_BENCH_ZOLTAN
  add_zoltan(wish, all);
#endif
#ifdef RCB_BENCH_ZOLTAN2
  add_zoltan2(wish, all);
#endif
  return all;
}

int run_as_rank(int argc, char** argv, const char* program, const RankBody& body) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);  // a rank doesn't outlive its mpirun
  auto session = ranks::MpiSession::start(&argc, &argv);
  if (!session || argc != 4) {
    fmt::print(stderr, "{}: {}\n", program, session ? "a rank's arguments are PLAN ROWS" : session.status().message());
    return 1;
  }
#ifdef RCB_BENCH_ZOLTAN2
  start_zoltan2(&argc, &argv);
#endif
  const Status status = body(session->comm(), argv[2], argv[3]);
#ifdef RCB_BENCH_ZOLTAN2
  finish_zoltan2();
#endif
  if (!status.ok()) fmt::print(stderr, "{}: rank {}: {}\n", program, session->rank(), status.message());
  session->finish(kFinishSeconds);
  return status.ok() ? 0 : 1;
}

RankBody with_plan(std::function<Status(comm::Comm&, const Plan&, const std::string& rows_path)> body) {
  return [body = std::move(body)](comm::Comm& comm, const std::string& plan_path, const std::string& rows_path) {
    const auto plan = load(plan_path);
    return comm::agree(comm, plan.ok()) ? body(comm, *plan, rows_path) : plan.status();
  };
}

int run_worker(int argc, char** argv) {
  keep_freed_memory();
  return run_as_rank(argc, argv, "rcb_bench", with_plan(run_static_cells));
}

}  // namespace rcb::bench
