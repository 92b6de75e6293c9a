// One rank of rcb_bench drift. The plan's `cut_tolerances` are the shares of particles that cross.
#include <bit>
#include <cmath>
#include <fstream>
#include <functional>
#include <numbers>

#include <fmt/format.h>

#include "common/base/clock.hpp"
#include "common/layout/layout.hpp"
#include "common/partition/balance/bounds.hpp"
#include "common/partition/partition.hpp"
#include "common/partition/repartition.hpp"
#include "server/service/step/exchange.hpp"
#include "tests/bench/json.hpp"
#include "tests/bench/measure.hpp"
#include "tests/bench/plan.hpp"
#include "tests/bench/scenes.hpp"
#include "tests/bench/step/drift.hpp"
#include "tests/bench/worker.hpp"
#include "tests/support/ranges_of.hpp"

namespace rcb::bench {
namespace {

using partition::Repartition;

// A way to new cuts.
struct Way {
  const char* name;
  double hysteresis;
  bool incremental;
};
constexpr Way kWays[] = {
    {"warm", 1.2, true}, {"cold", 1.2, false}, {"warm, pure rule", 1, true}, {"cold, pure rule", 1, false}};

// The particles with their owners, and where they were before the flow.
struct Held {
  service::Scene scene;
  std::array<Buffer<double>, 3> start;
  geometry::Box box;
};

// Collective.
Held hold(comm::Comm& comm, const SceneKind& kind, const Cell& cell) {
  const auto rank = static_cast<std::uint64_t>(comm.rank());
  const auto ranks = static_cast<std::uint64_t>(comm.size());
  Held held;
  service::Scene& scene = held.scene;
  scene.options.parts = cell.parts;
  scene.options.dims = kind.dims;
  scene.n = cell.n;
  scene.particles = make_rows(kind, cell.n, cell.n * rank / ranks, cell.n * (rank + 1) / ranks);
  partition::PartitionOptions options;
  options.parts = cell.parts;
  auto found = partition::partition(comm, scene.particles.view(), options);
  RCB_CHECK(found.ok(), found.status().message());
  scene.tree = std::make_shared<const cuts::CutTree>(std::move(found->tree));
  scene.part = std::move(found->part);
  service::send_strangers(comm, scene, true);
  for (std::size_t a = 0; a < static_cast<std::size_t>(kind.dims); ++a) held.start[a] = scene.particles.position[a];
  held.box = partition::bounding_box(comm, scene.particles.view());
  return held;
}

// Moves everything by a flow that gathers matter in some places and thins it in others. Local.
void flow(Held& held, double amplitude) {
  const auto dims = static_cast<std::size_t>(held.scene.options.dims);
  const std::size_t count = held.scene.particles.count();
  for (std::size_t i = 0; i < count; ++i) {
    geometry::Point unit{};
    for (std::size_t a = 0; a < dims; ++a)
      unit[a] = (held.start[a][i] - held.box.lo[a]) / std::max(held.box.hi[a] - held.box.lo[a], 1e-300);
    for (std::size_t a = 0; a < dims; ++a) {
      const double phase = 2 * std::numbers::pi * (unit[a] + 0.3 * unit[(a + 1) % dims]) + static_cast<double>(a);
      held.scene.particles.position[a][i] =
          held.start[a][i] + amplitude * (held.box.hi[a] - held.box.lo[a]) * (0.4 + std::sin(phase));
    }
  }
}

// The share of all particles that have left their part; `part` gets the new ones. Collective.
double crossed(comm::Comm& comm, const Held& held, Buffer<std::int32_t>& part) {
  const auto view = held.scene.particles.view();
  part.resize(view.count);
  held.scene.tree->classify(view, part.span());
  std::uint64_t count = 0;
  for (std::size_t i = 0; i < part.size(); ++i) count += part[i] != held.scene.part[i] ? 1U : 0U;
  comm.all_sum({&count, 1});
  return static_cast<double>(count) / static_cast<double>(held.scene.n);
}

// Collective; the slowest rank's.
double timed(comm::Comm& comm, const std::function<void()>& body) {
  static const SteadyClock clock;
  comm.barrier();
  const double begin = clock.seconds();
  body();
  comm.barrier();
  std::uint64_t bits = std::bit_cast<std::uint64_t>(clock.seconds() - begin);
  comm.all_max({&bits, 1});
  return std::bit_cast<double>(bits);
}

// Collective. The row is rank 0's.
Json run_cell(comm::Comm& comm, const SceneKind& kind, const Cell& cell, double share, int repeats) {
  Held held = hold(comm, kind, cell);
  Buffer<std::int32_t> part;
  double low = 0;
  double high = 0.5;
  double got = 0;
  for (int step = 0; step < 20; ++step) {
    const double amplitude = (low + high) / 2;
    flow(held, amplitude);
    got = crossed(comm, held, part);
    (got < share ? low : high) = amplitude;
    if (std::abs(got - share) < 0.02 * share) break;
  }
  const auto view = held.scene.particles.view();
  const partition::LoadSummary loads = partition::summarise_loads(comm, view, part.span(), {}, cell.parts);
  // As a step makes them while the positions arrive.
  const particles::BlockRanges blocks = testing::ranges_of(view);
  std::vector<Repartition> found(std::size(kWays));
  std::vector<std::vector<double>> seconds(std::size(kWays));
  std::vector<double> seconds_read;
  [[maybe_unused]] volatile std::uint64_t sum = 0;  // so that it is made
  for (int repeat = -1; repeat < repeats; ++repeat) {
    const double read = timed(comm, [&] { sum = read_positions(view); });
    if (repeat >= 0) seconds_read.push_back(read);
    for (std::size_t k = 0; k < std::size(kWays); ++k) {
      const std::size_t w = (k + static_cast<std::size_t>(repeat + 1)) % std::size(kWays);
      partition::RepartitionOptions options;
      options.partition.parts = cell.parts;
      options.partition.axis_hysteresis = kWays[w].hysteresis;
      options.partition.previous = held.scene.tree.get();
      options.incremental = kWays[w].incremental;
      const double took = timed(comm, [&] {
        found[w] = partition::repartition(comm, view, options, {*held.scene.tree, part.span(), loads, &blocks});
      });
      if (repeat >= 0) seconds[w].push_back(took);
    }
  }
  Json row{{"scene", cell.scene}, {"n", cell.n},          {"parts", cell.parts},        {"ranks", comm.size()},
           {"crossed", got},      {"read", seconds_read}, {"error_before", loads.error}};
  row["ways"] = Json::array();
  for (std::size_t w = 0; w < std::size(kWays); ++w) {
    std::uint64_t moved = found[w].delta.slot.size();
    comm.all_sum({&moved, 1});
    row["ways"].push_back({{"way", kWays[w].name},
                           {"seconds", seconds[w]},
                           {"moved", moved},
                           {"looked_at", found[w].cost.searched},
                           {"warm", found[w].incremental},
                           {"reductions", found[w].cost.reductions},
                           {"axes_flipped", cuts::axes_flipped(*held.scene.tree, found[w].tree)},
                           {"error", found[w].loads.error},
                           {"hash", fmt::format("{:016x}", found[w].tree.hash())}});
  }
  return row;
}

// Collective.
Status run_drift_cells(comm::Comm& comm, const Plan& plan, const std::string& rows_path) {
  std::ofstream rows;
  if (comm.rank() == 0) rows.open(rows_path);
  if (!comm::agree(comm, !rows.fail())) return {Code::io_error, rows_path + ": can't be written"};
  for (const Cell& cell : plan.cells) {
    const SceneKind* kind = find_scene_kind(cell.scene);
    if (kind == nullptr) return {Code::not_found, "no scene " + cell.scene};
    for (const double share : plan.wish.cut_tolerances) {
      if (comm.rank() == 0)
        fmt::print(stderr, "ranks {}: {}, {} points, {} parts\n", comm.size(), cell.scene, cell.n, cell.parts);
      const Json row = run_cell(comm, *kind, cell, share, plan.repeats);
      if (comm.rank() == 0) rows << row << std::endl;
    }
  }
  return {};
}

}  // namespace

int run_drift_worker(int argc, char** argv) {
  keep_freed_memory();
  return run_as_rank(argc, argv, "rcb_bench", with_plan(run_drift_cells));
}

}  // namespace rcb::bench
