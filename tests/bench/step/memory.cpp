#include "tests/bench/step/memory.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>

#include <fmt/format.h>

#include "client/launch/launch.hpp"
#include "client/lib/client.hpp"
#include "common/base/random.hpp"
#include "tests/bench/json.hpp"
#include "tests/bench/options.hpp"
#include "tests/bench/report.hpp"
#include "tests/bench/scenes.hpp"
#include "tests/bench/step/process_memory.hpp"

namespace rcb::bench {
namespace {

constexpr int kDims = 3;
constexpr double kTolerance = 0.02;
constexpr double kShift = 0.015;  // of the cube's side: 3 % of half of it
constexpr int kMovingSteps = 3;
constexpr double kDeadlineSeconds = 600;
constexpr double kMiB = 1024.0 * 1024.0;

// What the particles are: positions and ids. Nothing is weighted here.
double particle_bytes(std::uint64_t n) { return static_cast<double>(n) * (kDims * 8 + 8); }

using Axes = std::array<std::vector<double>, kDims>;

Axes uniform_axes(std::uint64_t n) {
  const particles::ParticleSet set = make_rows(*find_scene_kind("uniform"), n, 0, n);
  Axes axes;
  for (std::size_t a = 0; a < kDims; ++a) axes[a].assign(set.position[a].begin(), set.position[a].end());
  return axes;
}

// Every coordinate by up to a hundredth of the distance between two particles.
void jitter(Axes& axes, std::uint64_t seed) {
  Random random(seed);
  const double width = 0.01 / std::cbrt(static_cast<double>(axes[0].size()));
  for (auto& axis : axes)
    for (double& x : axis) x += random.uniform(-width, width);
}

void shift(Axes& axes) {
  for (double& x : axes[0]) x += kShift;
}

// Every particle to another's place, far away as a rule; and a shift, so that there are new cuts.
void scatter(Axes& axes) {
  for (auto& axis : axes) std::reverse(axis.begin(), axis.end());
  shift(axes);
}

// One service and the scene on it.
class Run {
 public:
  Run(const MemoryOptions& options, std::uint64_t n, int ranks, std::string path, Json& rows)
      : options_(options), n_(n), ranks_(ranks), path_(std::move(path)), axes_(uniform_axes(n)), rows_(rows) {}

  Status go() {
    auto service = launch::Embedded::start(ranks_, [](double) {});
    if (!service.ok()) return service.status();
    const auto pids = descendants("rcbd");
    if (pids.size() != static_cast<std::size_t>(ranks_))
      return {Code::internal, fmt::format("{} processes rcbd of {}", pids.size(), ranks_)};
    MemoryWatch watch(pids);
    auto empty = watch.read();
    if (!empty.ok()) return empty.status();
    empty_ = *empty;
    return service->explain(phases(service->endpoint(), watch));
  }

 private:
  Status phases(const std::string& endpoint, MemoryWatch& watch) {
    client::ConnectOptions connect;
    connect.endpoint = endpoint;
    connect.path = path_ == "gateway" ? client::Path::gateway : client::Path::direct;
    auto client = client::Client::connect(connect);
    if (!client.ok()) return client.status();
    client::SceneOptions scene_options;
    scene_options.parts = options_.parts;
    scene_options.tolerance = kTolerance;
    if (Status status = client->create_scene("memory", scene_options); !status.ok()) return status;
    auto scene = client->open_scene("memory");
    if (!scene.ok()) return scene.status();
    const auto phase = [&](const char* name, int steps, bool repartitions, const std::function<void(int)>& move) {
      return this->phase(watch, *scene, name, steps, repartitions, move);
    };
    Status status = phase("first push", 1, true, [](int) {});
    if (status.ok())
      status =
          phase("moving", kMovingSteps, false, [this](int k) { jitter(axes_, 10U + static_cast<std::uint64_t>(k)); });
    if (status.ok()) status = phase("repartition", 1, true, [this](int) { shift(axes_); });
    if (status.ok())
      status = phase("moving again", kMovingSteps, false,
                     [this](int k) { jitter(axes_, 20U + static_cast<std::uint64_t>(k)); });
    if (status.ok()) status = phase("scattered", 1, true, [this](int) { scatter(axes_); });
    if (status.ok())
      status = phase("moving at last", kMovingSteps, false,
                     [this](int k) { jitter(axes_, 30U + static_cast<std::uint64_t>(k)); });
    return status;
  }

  Status phase(MemoryWatch& watch, client::Scene& scene, const char* name, int steps, bool repartitions,
               const std::function<void(int)>& move) {
    if (Status status = watch.mark(); !status.ok()) return status;
    client::StepReport report;
    for (int k = 0; k < steps; ++k) {
      move(k);
      const std::array<const double*, kDims> pointers{axes_[0].data(), axes_[1].data(), axes_[2].data()};
      client::StepOptions options;
      options.deadline_seconds = kDeadlineSeconds;
      auto result = scene.step(client::Positions::axes(pointers, n_), options);
      if (!result.ok()) return result.status();
      report = std::move(result->report);
      if (report.repartitioned != repartitions)
        return {Code::internal, fmt::format("{}: {}", name, report.reason), "give more points, and parts by twos"};
    }
    const auto read = watch.read();
    if (!read.ok()) return read.status();
    tell(name, report, *read);
    return {};
  }

  void tell(const char* name, const client::StepReport& report, const MemoryReading& read) {
    const auto more = [](std::uint64_t value, std::uint64_t empty) { return value > empty ? value - empty : 0; };
    const std::uint64_t at_rest = more(read.pss, empty_.pss);
    const std::uint64_t peak = more(read.pss_peak, empty_.pss);
    const std::uint64_t peaks = std::max(peak, more(read.peak, empty_.rss));
    rows_.push_back({{"scene", "uniform"},
                     {"n", n_},
                     {"dims", kDims},
                     {"parts", options_.parts},
                     {"ranks", ranks_},
                     {"tool", "rcbd"},
                     {"method", "rcb"},
                     {"work", "memory"},
                     {"cut_tolerance", 0.0},
                     {"path", path_},
                     {"phase", name},
                     {"bytes_empty", empty_.pss},
                     {"bytes", at_rest},
                     {"bytes_peak", peak},
                     {"bytes_peaks", peaks},
                     {"peak_over_particles", static_cast<double>(peak) / particle_bytes(n_)},
                     {"drifted", report.drifted.value_or(0)},
                     {"moved", report.moved},
                     {"migrated", report.migrated},
                     {"seconds_search", report.seconds_search},
                     {"seconds_migrate", report.seconds_migrate},
                     {"seconds_total", report.seconds_total},
                     {"ratio", Json::object()}});
  }

  const MemoryOptions& options_;
  std::uint64_t n_;
  int ranks_;
  std::string path_;
  Axes axes_;
  Json& rows_;
  MemoryReading empty_;
};

std::string memory_table(const Json& rows) {
  std::vector<std::vector<std::string>> lines{
      {"path", "phase", "points", "ranks", "empty", "after", "peak", "over the particles", "sum of peaks"}};
  const auto mib = [](const Json& bytes) { return fmt::format("{:.0f}", bytes.get<double>() / kMiB); };
  for (const Json& row : rows)
    lines.push_back({row["path"], row["phase"], std::to_string(row["n"].get<std::uint64_t>()),
                     std::to_string(row["ranks"].get<int>()), mib(row["bytes_empty"]), mib(row["bytes"]),
                     mib(row["bytes_peak"]), fmt::format("{:.2f}", row["peak_over_particles"].get<double>()),
                     mib(row["bytes_peaks"])});
  return table(lines, 2) + "MiB of all ranks; all but `empty` beyond the empty service\n";
}

Status check(const MemoryOptions& options) {
  OptionCheck check("rcb_bench memory");
  check.whole("--points", options.points, 1, 1e9);
  check.between("--ranks", options.ranks, 1, kRanksMax);
  check.known("--paths", options.paths, [](const std::string& path) { return path == "direct" || path == "gateway"; });
  check.between("--parts", std::vector{options.parts}, 2, kPartsMax);
  check.holds(!options.most || *options.most > 0, "--most takes a number above 0");
  return check.status();
}

Status verdict_of(const Json& rows, const MemoryOptions& options) {
  if (!options.most) return {};
  for (const Json& row : rows)
    if (const double share = row["peak_over_particles"]; share > *options.most)
      return {Code::internal,
              fmt::format("{} points, {} ranks, {}, {}: the peak is {:.2f} times the particles, above {}",
                          row["n"].get<std::uint64_t>(), row["ranks"].get<int>(), row["path"].get<std::string>(),
                          row["phase"].get<std::string>(), share, *options.most)};
  return {};
}

}  // namespace

CLI::App* add_memory(CLI::App& app, MemoryOptions& options) {
  auto* command = app.add_subcommand("memory", "what a service holds for its particles, at its peak");
  add_list(*command, "--points", options.points, "numbers of particles, in three dimensions");
  add_list(*command, "--ranks", options.ranks, "numbers of MPI ranks, one service each");
  add_list(*command, "--paths", options.paths, "direct, gateway: the way that pushes go");
  command->add_option("--parts", options.parts, "parts of the scene")->capture_default_str();
  command->add_option("--most", options.most, "fail where a peak is more than this many times the particles");
  command->add_option("--json", options.json, "write the result to this file");
  return command;
}

Status run_memory(const MemoryOptions& options, Json document) {
  if (Status status = check(options); !status.ok()) return status;
  Json rows = Json::array();
  Status status;
  for (const double points : options.points)
    for (const int ranks : options.ranks)
      for (const std::string& path : options.paths)
        if (status.ok()) status = Run(options, static_cast<std::uint64_t>(points), ranks, path, rows).go();
  print(memory_table(rows));
  if (status.ok()) status = verdict_of(rows, options);
  document["rows"] = std::move(rows);
  if (Status written = write_result(options.json, document); !written.ok()) return written;
  return status;
}

}  // namespace rcb::bench
