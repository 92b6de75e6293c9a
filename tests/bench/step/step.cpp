#include "tests/bench/step/step.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "client/launch/launch.hpp"
#include "client/lib/client.hpp"
#include "common/base/clock.hpp"
#include "common/base/random.hpp"
#include "tests/bench/driver.hpp"
#include "tests/bench/json.hpp"
#include "tests/bench/measure.hpp"
#include "tests/bench/options.hpp"
#include "tests/bench/report.hpp"
#include "tests/bench/scenes.hpp"
#include "tests/bench/step/floor.hpp"
#include "tests/bench/step/step_members.hpp"

namespace rcb::bench {
namespace {

constexpr int kWarmUpSteps = 3;
// shared-memory: the solver computes in arrays of the library, rows or an array an axis; shared-memory-copy: it keeps
// its own rows. By sockets to each rank: axes, rows, float32 (axes).
// endpoint: rows through rank 0. members: a parallel solver's, with the particles of their parts, from shared memory;
// members-sockets and members-endpoint: the same by these ways. subset: every hundredth particle moved. connect: no
// step, but the time until a new client has been let in.
constexpr std::array kVariants{
    "shared-memory", "shared-memory-axes", "shared-memory-copy", "axes",    "rows",   "endpoint",
    "members",       "members-sockets",    "members-endpoint",   "float32", "subset", "unmoved",
    "connect"};
constexpr std::size_t kSubset = 100;
// The points that move in each scene. shuffled: neighbours in the arrays aren't neighbours in space.
struct StepScene {
  const char* name;
  const char* points;
  bool shuffled;
};
constexpr StepScene kStepScenes[] = {
    {"moving", "slope", false}, {"moving-2d", "plane", false}, {"moving-shuffled", "slope", true}};

// Two sets of positions, in turn, so that every particle moves at every step.
struct MovingPoints {
  int dims = 3;
  std::size_t n = 0;
  std::array<std::vector<double>, 3> axes[2];
  std::array<std::vector<float>, 3> singles[2];
  std::vector<double> rows[2];

  MovingPoints(const SceneKind& kind, std::size_t count, bool shuffled) : dims(kind.dims), n(count) {
    particles::ParticleSet set = make_rows(kind, n, 0, n);
    Random order(11);
    for (std::size_t i = n; shuffled && i > 1; --i) {
      const std::uint64_t other = order.below(i);
      for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a)
        std::swap(set.position[a][i - 1], set.position[a][other]);
    }
    // About a hundredth of the distance between two particles, a slope's being 1 and a unit square's 1/sqrt(n).
    const double width = 0.01 * (dims == 2 ? 1 / std::sqrt(static_cast<double>(n)) : 1.0);
    Random random(7);
    for (int phase = 0; phase < 2; ++phase) rows[phase].resize(n * static_cast<std::size_t>(dims));
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) {
      axes[0][a].assign(set.position[a].begin(), set.position[a].end());
      axes[1][a] = axes[0][a];
      for (double& x : axes[1][a]) x += width * (0.5 + random.uniform());
      for (int phase = 0; phase < 2; ++phase) singles[phase][a].assign(axes[phase][a].begin(), axes[phase][a].end());
      for (int phase = 0; phase < 2; ++phase)
        for (std::size_t i = 0; i < n; ++i) rows[phase][i * static_cast<std::size_t>(dims) + a] = axes[phase][a][i];
    }
  }
  // What a variant sends, and the sockets beside it.
  std::size_t bytes(const std::string& variant) const {
    const auto d = static_cast<std::size_t>(dims);
    if (variant == "float32") return n * d * sizeof(float);
    if (variant == "subset") return (n + kSubset - 1) / kSubset * (d * sizeof(double) + sizeof(std::uint64_t));
    return variant == "unmoved" || variant == "connect" ? 0 : n * d * sizeof(double);
  }
  client::Positions by_singles(int phase) const {
    std::array<const float*, 3> pointers{};
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) pointers[a] = singles[phase][a].data();
    return client::Positions::axes(std::span(pointers).first(static_cast<std::size_t>(dims)), n);
  }
  client::Positions by_axes(int phase) const {
    std::array<const double*, 3> pointers{};
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) pointers[a] = axes[phase][a].data();
    return client::Positions::axes(std::span(pointers).first(static_cast<std::size_t>(dims)), n);
  }
};

// One variant's scene, and its positions the way the variant has them.
class Pusher {
 public:
  Pusher(std::string variant, const MovingPoints& motion, int members) : variant_(std::move(variant)), motion_(motion) {
    if (variant_.starts_with("members")) team_.emplace(motion.axes, motion.dims, members);
    if (variant_ == "subset")
      for (std::size_t row = 0; row < motion.n; row += kSubset) moved_.push_back(row);
  }

  Status open(const std::string& endpoint, int parts) {
    client::ConnectOptions& options = connect_;
    options.endpoint = endpoint;
    options.path = variant_.ends_with("endpoint")                                   ? client::Path::gateway
                   : variant_.starts_with("shared-memory") || variant_ == "members" ? client::Path::shared
                                                                                    : client::Path::direct;
    auto client = client::Client::connect(options);
    if (!client.ok()) return client.status();
    client_.emplace(std::move(*client));
    if (variant_ == "connect") return {};
    client::SceneOptions scene;
    scene.parts = parts;
    scene.dims = motion_.dims;
    scene.tolerance = std::numeric_limits<double>::infinity();
    scene.replace = true;
    if (Status status = client_->create_scene("step-" + variant_, scene); !status.ok()) return status;
    if (team_) return team_->open(endpoint, "step-" + variant_, options.path);
    auto opened = client_->open_scene("step-" + variant_);
    if (!opened.ok()) return opened.status();
    scene_.emplace(std::move(*opened));
    return {};
  }

  int ranks() const { return client_->ranks(); }
  // The seconds of one step.
  Result<double> step(int phase, client::StepReport& report) {
    if (variant_ == "connect") return connect();
    if (team_) return team_->step(phase, report);
    auto positions = prepare(phase);
    if (!positions.ok()) return positions.status();
    const SteadyClock clock;
    const double start = clock.seconds();
    client::StepOptions options;
    if ((variant_ == "subset" || variant_ == "unmoved") && scene_->last_step()) options.moved = moved_;
    auto result = scene_->step(*positions, options);
    const double seconds = clock.seconds() - start;
    if (!result.ok()) return result.status();
    report = std::move(result->report);
    if (variant_.starts_with("shared-memory") != (report.way == "shared-memory"))
      return Status(Code::internal, fmt::format("variant {} went by {}", variant_, report.way));
    return seconds;
  }

 private:
  Result<client::Positions> prepare(int phase) {
    if (variant_ == "shared-memory") {
      const auto rows = scene_->position_rows(motion_.n);
      if (!rows.ok()) return rows.status();
      std::copy(motion_.rows[phase].begin(), motion_.rows[phase].end(), rows->begin());
      return client::Positions::rows(rows->data(), motion_.n, motion_.dims);
    }
    if (variant_ == "shared-memory-axes") {
      const auto axes = scene_->position_axes(motion_.n);
      if (!axes.ok()) return axes.status();
      std::array<const double*, 3> pointers{};
      for (std::size_t a = 0; a < axes->size(); ++a) {
        std::copy(motion_.axes[phase][a].begin(), motion_.axes[phase][a].end(), (*axes)[a].begin());
        pointers[a] = (*axes)[a].data();
      }
      return client::Positions::axes(std::span(pointers).first(axes->size()), motion_.n);
    }
    if (variant_ == "rows" || variant_ == "endpoint" || variant_ == "shared-memory-copy")
      return client::Positions::rows(motion_.rows[phase].data(), motion_.n, motion_.dims);
    if (variant_ == "float32") return motion_.by_singles(phase);
    return motion_.by_axes(phase);
  }

  Result<double> connect() const {
    const SteadyClock clock;
    const double start = clock.seconds();
    const auto client = client::Client::connect(connect_);
    if (!client.ok()) return client.status();
    return clock.seconds() - start;
  }

  std::string variant_;
  const MovingPoints& motion_;
  client::ConnectOptions connect_;
  std::vector<std::uint64_t> moved_;
  std::optional<client::Client> client_;
  std::optional<client::Scene> scene_;
  std::optional<MemberTeam> team_;  // instead
};

Json row_of(const std::string& scene, const MovingPoints& motion, int parts, int ranks, const std::string& variant,
            const std::vector<double>& seconds, double floor, double memory, const client::StepReport& report) {
  const auto [least, most] = std::minmax_element(seconds.begin(), seconds.end());
  return {{"scene", scene},
          {"n", motion.n},
          {"dims", motion.dims},
          {"parts", parts},
          {"ranks", ranks},
          {"tool", "rcbd"},
          {"method", "rcb"},
          {"work", "step"},
          {"variant", variant},
          {"cut_tolerance", 0.0},
          {"seconds", median(seconds)},
          {"seconds_min", *least},
          {"seconds_max", *most},
          {"floor_seconds", floor},
          {"memory_seconds", memory},
          {"seconds_receive", report.seconds_receive},
          {"seconds_exchange", report.seconds_exchange},
          {"seconds_total", report.seconds_total},
          {"error", report.error},
          {"empty_parts", 0},
          {"drifted", report.drifted},
          {"migrated", report.migrated},
          {"scanned", report.scanned},
          {"bytes", report.bytes},
          {"ratio", {{"floor", median(seconds) / floor}, {"memory", median(seconds) / memory}}}};
}

using FloorKey = std::pair<Floor::Kind, std::size_t>;  // with the bytes that are sent

// A variant at a service.
struct Timed {
  std::string variant;
  std::string service;  // as it was named; empty: the one that was started here
  Pusher pusher;
  std::vector<double> seconds = {};
  client::StepReport report = {};
};

void print(const Json& row) {
  const auto milliseconds = [&row](const char* name) { return 1e3 * row.at(name).get<double>(); };
  const Json& ratio = row.at("ratio");
  fmt::print(
      "{:<15} {:>2} ranks  {:<18} {:8.2f} ms; sockets {:6.2f} ms, ratio {:5.2f}; memory {:6.2f} ms, ratio {:5.2f}  "
      "(last: receive and pass {:.2f}, exchange {:.2f}, all {:.2f} ms){}{}\n",
      row.at("scene").get<std::string>(), row.at("ranks").get<int>(), row.at("variant").get<std::string>(),
      milliseconds("seconds"), milliseconds("floor_seconds"), ratio.at("floor").get<double>(),
      milliseconds("memory_seconds"), ratio.at("memory").get<double>(), milliseconds("seconds_receive"),
      milliseconds("seconds_exchange"), milliseconds("seconds_total"), row.contains("service") ? "  " : "",
      row.value("service", ""));
}

// At the running services, or, where none is named, at one that is started for it.
Status run_cell(const std::string& scene, const MovingPoints& motion, int parts, int ranks,
                const StepBenchOptions& options, Json& rows) {
  std::optional<launch::Embedded> own;
  std::vector<std::string> endpoints = options.services;
  if (endpoints.empty()) {
    auto started = launch::Embedded::start(ranks, [](double) {});
    if (!started.ok()) return started.status();
    own.emplace(std::move(*started));
    endpoints.push_back(own->endpoint());
  }
  const auto explained = [&own](const Status& status) { return own ? own->explain(status) : status; };
  std::map<FloorKey, Floor> floors;
  for (const std::string& variant : options.variants) {
    const std::size_t bytes = motion.bytes(variant);
    std::vector<std::size_t> shares;
    for (int r = 0; r < ranks; ++r)
      shares.push_back(bytes * static_cast<std::size_t>(r + 1) / static_cast<std::size_t>(ranks) -
                       bytes * static_cast<std::size_t>(r) / static_cast<std::size_t>(ranks));
    if (bytes == 0) shares = {1};  // a round trip is left
    for (const auto kind : {Floor::Kind::sockets, Floor::Kind::memory})
      floors.try_emplace(FloorKey(kind, bytes), kind, shares);
  }
  std::vector<Timed> contenders;
  for (const std::string& variant : options.variants)
    for (const std::string& endpoint : endpoints) {
      contenders.push_back({variant, own ? "" : endpoint, Pusher(variant, motion, options.members)});
      Status status = contenders.back().pusher.open(endpoint, parts);
      if (!status.ok()) return explained(status);
    }
  std::map<FloorKey, std::vector<double>> floor_seconds;
  const SteadyClock clock;
  for (int turn = -kWarmUpSteps; turn < options.repeats; ++turn) {
    const int phase = (turn + kWarmUpSteps) % 2;
    const auto* const from = reinterpret_cast<const std::byte*>(motion.rows[phase].data());
    for (auto& [key, floor] : floors) {
      floor.load(from);
      const double start = clock.seconds();
      if (!floor.send(from)) return {Code::internal, "a process of the floor is gone"};
      if (turn >= 0) floor_seconds[key].push_back(clock.seconds() - start);
    }
    for (Timed& one : contenders) {
      const auto took = one.pusher.step(phase, one.report);
      if (!took.ok()) return explained(took.status());
      if (turn >= 0) one.seconds.push_back(*took);
    }
  }
  for (const Timed& one : contenders) {
    const double least = median(floor_seconds[{Floor::Kind::sockets, motion.bytes(one.variant)}]);
    const double memory = median(floor_seconds[{Floor::Kind::memory, motion.bytes(one.variant)}]);
    rows.push_back(
        row_of(scene, motion, parts, one.pusher.ranks(), one.variant, one.seconds, least, memory, one.report));
    if (!own) rows.back()["service"] = one.service;
    print(rows.back());
  }
  return {};
}

const StepScene* find_step_scene(const std::string& name) {
  const auto* const found = std::find_if(std::begin(kStepScenes), std::end(kStepScenes),
                                         [&](const StepScene& known) { return name == known.name; });
  return found == std::end(kStepScenes) ? nullptr : found;
}

Status check(const StepBenchOptions& options) {
  OptionCheck check("rcb_bench step");
  check.known("--scenes", options.scenes, [](const std::string& scene) { return find_step_scene(scene) != nullptr; });
  check.known("--variants", options.variants, [](const std::string& variant) {
    return std::find(kVariants.begin(), kVariants.end(), variant) != kVariants.end();
  });
  check.between("--parts", options.parts, 1, kPartsMax);
  check.between("--ranks", options.ranks, 1, kRanksMax);
  check.between("--members", std::vector{options.members}, 1, 256);
  check.between("--repeats", std::vector{options.repeats}, 1, kRepeatsMax);
  check.whole("--points", {options.points}, 1, 1e9);
  return check.status();
}

}  // namespace

CLI::App* add_step(CLI::App& app, StepBenchOptions& options) {
  auto* command = app.add_subcommand(
      "step", "time of a step in which all particles move and no new cuts are needed, beside bare sockets");
  add_list(*command, "--scenes", options.scenes, "moving (3-D), moving-2d, moving-shuffled (rows in random order)");
  add_list(*command, "--variants", options.variants, fmt::format("ways to push: {}", fmt::join(kVariants, ", ")));
  add_list(*command, "--parts", options.parts, "numbers of parts");
  add_list(*command, "--ranks", options.ranks, "numbers of MPI ranks, one service each");
  command
      ->add_option("--services", options.services,
                   "endpoints of running services that take turns, instead of one that is started; --ranks then only "
                   "tells the floors' processes")
      ->delimiter(',');
  command->add_option("--members", options.members, "of the parallel solver")->capture_default_str();
  command->add_option("--repeats", options.repeats, "timed steps of each variant")->capture_default_str();
  command->add_option("--points", options.points, "particles of every scene")->capture_default_str();
  command->add_option("--json", options.json, "write the result to this file");
  return command;
}

Status run_step(const StepBenchOptions& options, Json document) {
  if (Status status = check(options); !status.ok()) return status;
  Json rows = Json::array();
  Status status;
  for (const std::string& scene : options.scenes) {
    const StepScene& of = *find_step_scene(scene);
    const MovingPoints motion(*find_scene_kind(of.points), static_cast<std::size_t>(options.points), of.shuffled);
    for (const int parts : options.parts)
      for (const int ranks : options.ranks)
        if (status.ok()) status = run_cell(scene, motion, parts, ranks, options, rows);
  }
  document["rows"] = std::move(rows);
  if (Status written = write_result(options.json, document); !written.ok()) return written;
  return status;
}

}  // namespace rcb::bench
