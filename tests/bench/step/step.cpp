#include "tests/bench/step/step.hpp"

#include <algorithm>
#include <compare>
#include <map>
#include <optional>
#include <span>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "client/launch/launch.hpp"
#include "tests/bench/driver.hpp"
#include "tests/bench/json.hpp"
#include "tests/bench/measure.hpp"
#include "tests/bench/options.hpp"
#include "tests/bench/report.hpp"
#include "tests/bench/scenes.hpp"
#include "tests/bench/step/floor.hpp"
#include "tests/bench/step/step_pusher.hpp"

namespace rcb::bench {
namespace {

constexpr int kWarmUpSteps = 3;
// The points that move in each scene. shuffled: neighbours in the arrays aren't neighbours in space.
struct StepScene {
  const char* name;
  const char* points;
  std::size_t n;
  bool shuffled;
};
constexpr StepScene kStepScenes[] = {{"moving", "slope", 1'068'285, false},
                                     {"moving-2d", "plane", 1'068'285, false},
                                     {"moving-shuffled", "slope", 1'068'285, true},
                                     {"moving-small", "slope", 1500, false}};

struct FloorKey {
  Floor::Kind kind;
  std::size_t bytes;
  int processes;
  auto operator<=>(const FloorKey&) const = default;
};

// The floors of a cell, each with its seconds.
class Floors {
 public:
  // By the names of `ratio`. ranks: of the service.
  static std::vector<std::pair<const char*, FloorKey>> of(const std::string& variant, const MovingPoints& motion,
                                                          int ranks, int seats) {
    std::vector<std::pair<const char*, FloorKey>> keys;
    if (const std::size_t read = motion.bytes_read(variant); read > 0)
      keys.push_back({"read", {Floor::Kind::read, read, by_seats(variant) ? seats : 1}});
    if (is_count(variant)) return keys;
    const std::size_t sent = motion.bytes_sent(variant);
    for (const auto& [name, kind] : {std::pair{"floor", Floor::Kind::sockets}, {"memory", Floor::Kind::memory}})
      keys.push_back({name, sent > 0 ? FloorKey{kind, sent, ranks} : FloorKey{kind, 1, 1}});  // connect: a round trip
    return keys;
  }

  void add(const FloorKey& key) {
    const auto processes = static_cast<std::size_t>(key.processes);
    std::vector<std::size_t> shares;
    for (std::size_t p = 0; p < processes; ++p)
      shares.push_back(key.bytes * (p + 1) / processes - key.bytes * p / processes);
    floors_.try_emplace(key, key.kind, shares);
  }
  Status take_turn(std::span<const double> bytes, bool timed) {
    for (auto& [key, floor] : floors_) {
      const auto seconds = floor.seconds(reinterpret_cast<const std::byte*>(bytes.data()));
      if (!seconds) return {Code::internal, "a process of the floor is gone"};
      if (timed) seconds_[key].push_back(*seconds);
    }
    return {};
  }
  double median_of(const FloorKey& key) const { return median(seconds_.at(key)); }

 private:
  std::map<FloorKey, Floor> floors_;
  std::map<FloorKey, std::vector<double>> seconds_;
};

// A variant at a service.
struct Timed {
  std::string variant;
  std::string service;  // as it was named; empty: the one that was started here
  Pusher pusher;
  std::vector<double> seconds = {};
  std::vector<double> round_trips = {};  // beside counts
  client::StepReport report = {};
};

struct StepCell {
  std::string scene;
  const MovingPoints& motion;
  int parts;
  int ranks;
};

Json row_of(const StepCell& cell, const Timed& one, const std::vector<std::pair<std::string, double>>& floors) {
  const client::StepReport& report = one.report;
  const auto [least, most] = std::minmax_element(one.seconds.begin(), one.seconds.end());
  Json row{{"scene", cell.scene},
           {"n", cell.motion.n},
           {"dims", cell.motion.dims},
           {"parts", cell.parts},
           {"ranks", one.pusher.ranks()},
           {"tool", "rcbd"},
           {"method", "rcb"},
           {"work", "step"},
           {"variant", one.variant},
           {"cut_tolerance", 0.0},
           {"seconds", median(one.seconds)},
           {"seconds_min", *least},
           {"seconds_max", *most},
           {"seconds_receive", report.seconds_receive},
           {"seconds_exchange", report.seconds_exchange},
           {"seconds_search", report.seconds_search},
           {"seconds_total", report.seconds_total},
           {"error", report.error},
           {"empty_parts", 0},
           {"repartitioned", report.repartitioned},
           {"drifted", report.drifted.value_or(0)},
           {"migrated", report.migrated},
           {"scanned", report.scanned},
           {"bytes", report.bytes}};
  if (is_count(one.variant)) row["message_bytes"] = report.bytes;
  Json ratio = Json::object();
  for (const auto& [name, seconds] : floors) {
    row[name + "_seconds"] = seconds;
    ratio[name] = median(one.seconds) / seconds;
  }
  row["ratio"] = std::move(ratio);
  if (!one.service.empty()) row["service"] = one.service;
  return row;
}

void print_row(const Json& row) {
  const auto milliseconds = [&row](const std::string& name) { return 1e3 * row.at(name).get<double>(); };
  std::string floors;
  for (const auto& [name, ratio] : row.at("ratio").items())
    floors += fmt::format("; {} {:.3f} ms, ratio {:.2f}", name, milliseconds(name + "_seconds"), ratio.get<double>());
  fmt::print(
      "{:<15} {:>2} ranks {:>5} parts  {:<18} {:8.3f} ms{}  (last: receive and pass {:.2f}, exchange {:.2f}, "
      "search {:.2f}, all {:.2f} ms{}){}{}\n",
      row.at("scene").get<std::string>(), row.at("ranks").get<int>(), row.at("parts").get<int>(),
      row.at("variant").get<std::string>(), milliseconds("seconds"), floors, milliseconds("seconds_receive"),
      milliseconds("seconds_exchange"), milliseconds("seconds_search"), milliseconds("seconds_total"),
      row.contains("message_bytes") ? fmt::format("; {} bytes", row["message_bytes"].get<std::uint64_t>()) : "",
      row.contains("service") ? "  " : "", row.value("service", ""));
}

Status take_turn(Timed& one, int phase, bool timed, RoundTrip& round_trip) {
  const auto seconds = one.pusher.step(phase, one.report);
  if (!seconds.ok()) return seconds.status();
  if (timed) one.seconds.push_back(*seconds);
  if (!is_count(one.variant)) return {};
  const auto bare = round_trip.seconds(one.report.bytes, one.report.json.size());
  if (!bare) return {Code::internal, "the process of the bare round trip is gone"};
  if (timed) one.round_trips.push_back(*bare);
  return {};
}

// At the running services, or, where none is named, at one that is started for it.
Status run_cell(const StepCell& cell, const StepBenchOptions& options, Json& rows) {
  std::optional<launch::Embedded> own;
  std::vector<std::string> endpoints = options.services;
  if (endpoints.empty()) {
    auto started = launch::Embedded::start(cell.ranks, [](double) {});
    if (!started.ok()) return started.status();
    own.emplace(std::move(*started));
    endpoints.push_back(own->endpoint());
  }
  const auto explained = [&own](const Status& status) { return own ? own->explain(status) : status; };
  const auto floors_of = [&](const std::string& variant) {
    return Floors::of(variant, cell.motion, cell.ranks, options.seats);
  };
  RoundTrip round_trip;
  Floors floors;
  for (const std::string& variant : options.variants)
    for (const auto& [name, key] : floors_of(variant)) floors.add(key);
  std::vector<double> bytes = cell.motion.rows[0];  // with room for ids
  bytes.resize(bytes.size() + cell.motion.n);
  std::vector<Timed> contenders;
  for (const std::string& variant : options.variants)
    for (const std::string& endpoint : endpoints) {
      contenders.push_back({variant, own ? "" : endpoint, Pusher(variant, cell.motion, options.seats)});
      Status status = contenders.back().pusher.open(endpoint, cell.parts);
      if (!status.ok()) return explained(status);
    }
  for (int turn = -kWarmUpSteps; turn < options.repeats; ++turn) {
    const int phase = (turn + kWarmUpSteps) % 2;
    if (Status status = floors.take_turn(bytes, turn >= 0); !status.ok()) return status;
    for (Timed& one : contenders)
      if (Status status = take_turn(one, phase, turn >= 0, round_trip); !status.ok()) return explained(status);
  }
  for (const Timed& one : contenders) {
    std::vector<std::pair<std::string, double>> beside;
    for (const auto& [name, key] : floors_of(one.variant)) beside.emplace_back(name, floors.median_of(key));
    if (is_count(one.variant)) beside.emplace_back("round_trip", median(one.round_trips));
    rows.push_back(row_of(cell, one, beside));
    print_row(rows.back());
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
    return std::find(kStepVariants.begin(), kStepVariants.end(), variant) != kStepVariants.end();
  });
  check.between("--parts", options.parts, 1, kPartsMax);
  check.between("--ranks", options.ranks, 1, kRanksMax);
  check.between("--members", std::vector{options.seats}, 1, 256);
  check.between("--repeats", std::vector{options.repeats}, 1, kRepeatsMax);
  check.whole("--points", {options.points}, 0, 1e9);
  return check.status();
}

}  // namespace

CLI::App* add_step(CLI::App& app, StepBenchOptions& options) {
  auto* command = app.add_subcommand(
      "step", "time of a step in which all particles move, beside reading their positions, bare sockets and messages");
  add_list(*command, "--scenes", options.scenes,
           "moving (3-D), moving-2d, moving-shuffled (rows in random order), moving-small (1,500 particles)");
  add_list(*command, "--variants", options.variants, fmt::format("kinds of step: {}", fmt::join(kStepVariants, ", ")));
  add_list(*command, "--parts", options.parts, "numbers of parts");
  add_list(*command, "--ranks", options.ranks, "numbers of MPI ranks, one service each");
  command
      ->add_option("--services", options.services,
                   "endpoints of running services that take turns, instead of one that is started; --ranks then only "
                   "tells the floors' processes")
      ->delimiter(',');
  command->add_option("--members", options.seats, "of the parallel solver")->capture_default_str();
  command->add_option("--repeats", options.repeats, "timed steps of each variant")->capture_default_str();
  command->add_option("--points", options.points, "particles of every scene, instead of its own number");
  add_list(
      *command, "--hosts", options.links.hosts,
      "count-members alone, over links: numbers of machines, rank 0 on the first, the solver on the second (as root)");
  add_list(*command, "--latency", options.links.latency, "with --hosts: round trips between machines, in milliseconds");
  add_list(*command, "--bandwidth", options.links.bandwidth, "with --hosts: of a link, in Gbit/s");
  command->add_option("--json", options.json, "write the result to this file");
  return command;
}

HostsOptions over_links(const StepBenchOptions& options) {
  HostsOptions links = options.links;
  links.points = options.points > 0 ? options.points : static_cast<double>(kStepScenes[0].n);
  links.repeats = options.repeats;
  links.json = options.json;
  links.counts_alone = true;
  return links;
}

Status run_step(const StepBenchOptions& options, Json document) {
  if (Status status = check(options); !status.ok()) return status;
  Json rows = Json::array();
  Status status;
  for (const std::string& scene : options.scenes) {
    const StepScene& of = *find_step_scene(scene);
    const auto points = options.points > 0 ? static_cast<std::size_t>(options.points) : of.n;
    const MovingPoints motion(*find_scene_kind(of.points), points, of.shuffled);
    for (const int parts : options.parts)
      for (const int ranks : options.ranks)
        if (status.ok()) status = run_cell({scene, motion, parts, ranks}, options, rows);
  }
  document["rows"] = std::move(rows);
  if (Status written = write_result(options.json, document); !written.ok()) return written;
  return status;
}

}  // namespace rcb::bench
