#include "tests/bench/cuts.hpp"

#include <algorithm>
#include <functional>
#include <numeric>

#include <fmt/format.h>

#include "common/base/clock.hpp"
#include "common/base/exact_scale.hpp"
#include "common/base/index.hpp"
#include "common/base/random.hpp"
#include "common/cuts/count.hpp"
#include "common/partition/partition.hpp"
#include "tests/bench/measure.hpp"
#include "tests/bench/options.hpp"
#include "tests/bench/report.hpp"
#include "tests/bench/scenes.hpp"
#include "tests/support/self_comm.hpp"

namespace rcb::bench {
namespace {

// The scene's particles in the order of their parts, as a solver holds them that has been given them, or shuffled.
struct OrderedRows {
  std::string order;
  particles::ParticleSet particles;
  std::vector<double> rows;  // [count][dims]
  std::vector<float> floats;
  std::vector<std::int32_t> part;
};

OrderedRows in_order(const particles::ParticleSet& all, std::span<const std::int32_t> part, const std::string& order) {
  std::vector<std::size_t> from(all.count());
  std::iota(from.begin(), from.end(), std::size_t{0});
  Random random(1);
  for (std::size_t i = from.size(); i > 1; --i) std::swap(from[i - 1], from[random.below(i)]);
  if (order == "by part")
    std::stable_sort(from.begin(), from.end(), [&](std::size_t a, std::size_t b) { return part[a] < part[b]; });
  OrderedRows rows{order, all, {}, {}, {}};
  for (std::size_t i = 0; i < from.size(); ++i) {
    rows.particles.id[i] = all.id[from[i]];
    rows.part.push_back(part[from[i]]);
    for (std::size_t a = 0; a < at(all.dims); ++a) {
      rows.particles.position[a][i] = all.position[a][from[i]];
      rows.rows.push_back(all.position[a][from[i]]);
      rows.floats.push_back(static_cast<float>(rows.rows.back()));
    }
  }
  return rows;
}

struct Work {
  std::string name;
  std::function<std::uint64_t()> run;  // returns a number that depends on what it does
};

std::vector<Work> works_of(const cuts::Cuts& cuts, const OrderedRows& rows, const CutsBenchOptions& options,
                           std::vector<std::int32_t>& part) {
  const std::size_t count = rows.particles.count();
  geometry::Box box;
  for (std::size_t a = 0; a < at(rows.particles.dims); ++a) {
    const auto [lo, hi] = std::minmax_element(rows.particles.position[a].begin(), rows.particles.position[a].end());
    box.lo[a] = *lo;
    box.hi[a] = *hi;
  }
  double side = 0;
  for (std::size_t a = 0; a < at(rows.particles.dims); ++a) side = std::max(side, box.hi[a] - box.lo[a]);
  const std::array<const double*, 3> axes{rows.particles.position[0].data(), rows.particles.position[1].data(),
                                          rows.particles.position[2].data()};
  const auto by_axes = cuts::Positions::axes(axes, count);
  const auto by_rows = cuts::Positions::rows(rows.rows.data(), count, rows.particles.dims);
  const auto by_floats = cuts::Positions::rows(rows.floats.data(), count, rows.particles.dims);
  cuts::HaloOptions halo;
  halo.ids = rows.particles.id.span();
  halo.threads = options.threads;
  halo.near.width = options.width * side;
  cuts::HaloOptions periodic = halo;
  periodic.near.box = cuts::PeriodicBox(box.lo, box.hi);
  cuts::HaloOptions euclid = halo;
  euclid.near.norm = cuts::Norm::euclid;
  cuts::HaloOptions hinted = halo;
  hinted.last_part = rows.part;
  const auto owner = [&cuts, &part](const cuts::Positions& positions, const cuts::OwnerOptions& with) {
    return Work{"owner", [&cuts, &part, positions, with]() -> std::uint64_t {
                  return cuts.owner(positions, with, part).ok() ? at(part[part.size() / 2]) : 0;
                }};
  };
  const auto halos = [&cuts](const char* name, const cuts::Positions& positions, const cuts::HaloOptions& with) {
    return Work{name,
                [&cuts, positions, with]() -> std::uint64_t { return cuts.halo(positions, with).value().entries(); }};
  };
  std::vector<Work> works{{"read", [&rows] { return read_positions(rows.particles.view()); }}};
  works.push_back(owner(by_axes, halo));
  works.push_back(owner(by_rows, halo));
  works.back().name = "owner, rows";
  works.push_back(owner(by_floats, halo));
  works.back().name = "owner, float rows";
  works.push_back(owner(by_axes, hinted));
  works.back().name = "owner, last parts";
  // As a step counts: the hint is the array that takes the parts. Uneven weights, all within the scale.
  cuts::CountOptions counted;
  counted.ids = halo.ids;
  counted.threads = options.threads;
  counted.last_part = part;
  cuts::CountOptions weighted = counted;
  weighted.weights = rows.particles.position[0].span();
  weighted.scale = ExactScale(box.hi[0], count).exponent();
  const auto counts = [&cuts, &part](const char* name, const cuts::Positions& positions,
                                     const cuts::CountOptions& with) {
    return Work{name, [&cuts, &part, positions, with]() -> std::uint64_t {
                  return cuts::count(cuts, positions, with, part).value().counts[0];
                }};
  };
  works.push_back(counts("count", by_axes, counted));
  works.push_back(counts("count, rows", by_rows, counted));
  works.push_back(counts("count, float rows", by_floats, counted));
  works.push_back(counts("count, weights", by_axes, weighted));
  works.push_back(halos("halo", by_axes, halo));
  works.push_back(halos("halo, rows", by_rows, halo));
  works.push_back(halos("halo, Euclidean", by_axes, euclid));
  works.push_back(halos("halo, periodic", by_axes, periodic));
  return works;
}

// All works in turn, repeat after repeat.
void measure_rows(const cuts::Cuts& cuts, const OrderedRows& rows, const CutsBenchOptions& options, Json& out) {
  std::vector<std::int32_t> part(rows.particles.count());
  const std::vector<Work> works = works_of(cuts, rows, options, part);
  std::vector<std::vector<double>> seconds(works.size());
  std::vector<std::uint64_t> result(works.size());
  const SteadyClock clock;
  for (int repeat = -1; repeat < options.repeats; ++repeat)
    for (std::size_t k = 0; k < works.size(); ++k) {
      const double begin = clock.seconds();
      result[k] = works[k].run();
      if (repeat >= 0) seconds[k].push_back(clock.seconds() - begin);
    }
  for (std::size_t k = 0; k < works.size(); ++k) {
    const auto [least, most] = std::minmax_element(seconds[k].begin(), seconds[k].end());
    std::vector<double> ratios;
    for (std::size_t i = 0; i < seconds[k].size(); ++i) ratios.push_back(seconds[k][i] / seconds[0][i]);
    Json row{{"scene", "uniform"},
             {"n", rows.particles.count()},
             {"dims", cuts.dims()},
             {"parts", cuts.parts()},
             {"ranks", 1},
             {"tool", "rcbd"},
             {"method", "rcb"},
             {"work", works[k].name},
             {"order", rows.order},
             {"cut_tolerance", 0.0},
             {"threads", options.threads},
             {"seconds", median(seconds[k])},
             {"seconds_min", *least},
             {"seconds_max", *most},
             {"ratio", {{"read", median(ratios)}}}};
    if (works[k].name.starts_with("halo")) row["entries"] = result[k];
    out.push_back(std::move(row));
  }
}

std::string cuts_table(const Json& rows) {
  std::vector<std::vector<std::string>> lines{{"work", "order", "parts", "ms", "/ read", "entries"}};
  for (const Json& row : rows)
    lines.push_back({row["work"].get<std::string>(), row["order"].get<std::string>(), row["parts"].dump(),
                     fmt::format("{:.2f}", 1e3 * row["seconds"].get<double>()),
                     fmt::format("{:.2f}", row["ratio"]["read"].get<double>()),
                     row.contains("entries") ? row["entries"].dump() : ""});
  return table(lines, 2);
}

}  // namespace

CLI::App* add_cuts(CLI::App& app, CutsBenchOptions& options) {
  auto* command = app.add_subcommand("cuts", "owners and halos from the cuts alone, beside reading the positions once");
  command->add_option("--points", options.points, "particles")->capture_default_str();
  add_list(*command, "--parts", options.parts, "numbers of parts");
  command->add_option("--width", options.width, "of the halo, as a fraction of the box's longest side")
      ->capture_default_str();
  command->add_option("--threads", options.threads, "threads of owner and halo")->capture_default_str();
  command->add_option("--repeats", options.repeats, "timed runs of each")->capture_default_str();
  command->add_option("--json", options.json, "write the result to this file");
  return command;
}

Status run_cuts(const CutsBenchOptions& options, Json document) {
  OptionCheck check("rcb_bench cuts");
  check.whole("--points", std::vector{options.points}, 1, 1e9);
  check.between("--parts", options.parts, 1, kPartsMax);
  check.between("--width", std::vector{options.width}, 0, 10);
  check.between("--threads", std::vector{options.threads}, 1, 256);
  check.between("--repeats", std::vector{options.repeats}, 1, kRepeatsMax);
  if (!check.status().ok()) return check.status();
  keep_freed_memory();
  const auto n = static_cast<std::uint64_t>(options.points);
  const particles::ParticleSet all = make_rows(*find_scene_kind("uniform"), n, 0, n);
  document["rows"] = Json::array();
  for (const int parts : options.parts) {
    partition::PartitionOptions with;
    with.parts = parts;
    testing::SelfComm comm;
    const auto made = partition::partition(comm, all.view(), with).value();
    const cuts::Cuts cuts(made.tree, 1);
    for (const char* order : {"by part", "shuffled"})
      measure_rows(cuts, in_order(all, made.part.span(), order), options, document["rows"]);
  }
  print(cuts_table(document["rows"]));
  return write_result(options.json, document);
}

}  // namespace rcb::bench
