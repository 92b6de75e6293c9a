#include "tests/bench/step/skips.hpp"

#include <algorithm>
#include <cstdlib>
#include <limits>
#include <map>

#include <fmt/format.h>

#include "client/launch/launch.hpp"
#include "common/base/clock.hpp"
#include "tests/bench/driver.hpp"
#include "tests/bench/json.hpp"
#include "tests/bench/measure.hpp"
#include "tests/bench/options.hpp"
#include "tests/bench/report.hpp"
#include "tests/bench/step/skips_cases.hpp"

namespace rcb::bench {
namespace {

using Services = std::map<std::string, launch::Embedded>;  // by what they don't skip

constexpr const char* kVariable = "RCBD_NO_SKIP";
constexpr int kWarmUpTurns = 2;
constexpr const char* kScene = "skips";

// One side at work: its scene on its service.
class Player {
 public:
  Player(const Case& what, const Side& side, std::size_t count)
      : first_(std::string(what.work) == "first push"),
        tolerance_(what.tolerance < 0 ? std::numeric_limits<double>::infinity() : what.tolerance),
        asks_(side.asks),
        points_(side, count) {}

  Status open(const std::string& endpoint, const std::string& name, int parts) {
    client::ConnectOptions options;
    options.endpoint = endpoint;
    options.path = client::Path::shared;
    auto client = client::Client::connect(options);
    if (!client.ok()) return client.status();
    client_.emplace(std::move(*client));
    name_ = std::string(kScene) + "-" + name;
    parts_ = parts;
    return make_scene();
  }

  // The seconds of one turn.
  Result<double> turn(int phase, client::StepReport& report) {
    if (first_)
      if (Status status = make_scene(); !status.ok()) return status;
    const SteadyClock clock;
    const double start = clock.seconds();
    auto result = scene_->step(points_.at(first_ ? 0 : phase), points_.options());
    if (!result.ok()) return result.status();
    if (!asks_.empty()) {
      const auto reply = client_->call(asks_, scene_json());
      if (!reply.ok()) return reply.status();
    }
    const double seconds = clock.seconds() - start;
    report = std::move(result->report);
    return seconds;
  }

  // {"hash", "checksum"} of the parts as they are, and the questions that were "asked" before.
  Result<Json> answer() {
    const auto stats = client_->call("stats", scene_json());
    if (!stats.ok()) return stats.status();
    Json arguments = Json::parse(scene_json());
    arguments["checksum"] = true;
    const auto reply = client_->call("assign", arguments.dump());
    if (!reply.ok()) return reply.status();
    const Json json = Json::parse(reply->json);
    return Json{
        {"hash", json.at("hash")}, {"checksum", json.at("checksum")}, {"asked", Json::parse(stats->json).at("asked")}};
  }

  Status close() {
    scene_.reset();
    return client_->drop_scene(name_);
  }
  int dims() const { return points_.dims(); }

 private:
  std::string scene_json() const { return Json{{"scene", name_}}.dump(); }

  Status make_scene() {
    scene_.reset();
    client::SceneOptions options;
    options.parts = parts_;
    options.dims = points_.dims();
    options.tolerance = tolerance_;
    options.replace = true;
    if (Status status = client_->create_scene(name_, options); !status.ok()) return status;
    auto opened = client_->open_scene(name_);
    if (!opened.ok()) return opened.status();
    scene_.emplace(std::move(*opened));
    return {};
  }

  bool first_;
  double tolerance_;
  std::string asks_;
  SidePoints points_;
  std::string name_;
  int parts_ = 1;
  std::optional<client::Client> client_;
  std::optional<client::Scene> scene_;
};

// What of a report must not depend on a skip.
Json outcome(const client::StepReport& report) {
  return {{"step", report.step},
          {"epoch", report.epoch},
          {"n", report.n},
          {"error_before", report.error_before ? Json(*report.error_before) : Json()},
          {"error", report.error},
          {"imbalance", report.imbalance},
          {"repartitioned", report.repartitioned},
          {"axes_flipped", report.axes_flipped},
          {"moved", report.moved},
          {"migrated", report.migrated}};
}

struct Measured {
  std::vector<double> seconds;
  client::StepReport report;  // the last
  Json answer;
};

Json row_of(const Case& what, const Side& side, bool on, const Player& player, std::size_t n, int parts, int ranks,
            const Measured& measured) {
  const auto [least, most] = std::minmax_element(measured.seconds.begin(), measured.seconds.end());
  const client::StepReport& report = measured.report;
  return {{"scene", what.skip},
          {"n", n},
          {"dims", player.dims()},
          {"parts", parts},
          {"ranks", ranks},
          {"tool", "rcbd"},
          {"method", "rcb"},
          {"work", what.work},
          {"points", side.points},
          {"skip", on},
          {"variant", side.words},
          {"cut_tolerance", 0.0},
          {"seconds", median(measured.seconds)},
          {"seconds_min", *least},
          {"seconds_max", *most},
          {"seconds_receive", report.seconds_receive},
          {"seconds_exchange", report.seconds_exchange},
          {"seconds_search", report.seconds_search},
          {"seconds_migrate", report.seconds_migrate},
          {"error", report.error},
          {"empty_parts", 0},
          {"bytes", report.bytes},
          {"scanned", report.scanned},
          {"searched", report.searched},
          {"rounds", report.rounds},
          {"reductions", report.reductions},
          {"skipped", report.skipped},
          {"asked", measured.answer["asked"]},
          {"hash", measured.answer["hash"]},
          {"checksum", measured.answer["checksum"]},
          {"ratio", Json::object()}};
}

std::string name_of(const Case& what) {
  return fmt::format("{}, {}: {} against {}", what.skip, what.work, what.on.words, what.off.words);
}

// Whether both sides said the same, where they must.
Status compare(const Case& what, const Measured& on, const Measured& off) {
  if (!what.same_answers) return {};
  const auto differ = [&what](const Json& a, const Json& b) {
    return Status(Code::internal, fmt::format("{}: answers differ: {} and {}", name_of(what), a.dump(), b.dump()));
  };
  Json a = outcome(on.report), b = outcome(off.report);
  // Not every way lets somebody see it at the first step with other cuts.
  if (on.report.drifted && off.report.drifted) a["drifted"] = *on.report.drifted, b["drifted"] = *off.report.drifted;
  if (a != b) return differ(a, b);
  if (on.answer.is_null()) return {};
  if (on.answer["checksum"] != off.answer["checksum"] || (what.same_hash && on.answer["hash"] != off.answer["hash"]))
    return differ(on.answer, off.answer);
  return {};
}

// Both sides in turn.
Status run_case(const Case& what, const Services& services, std::size_t points, int parts, int ranks, int repeats,
                Json& rows) {
  const std::size_t n = std::max<std::size_t>(points / what.fewer, 1);
  const std::array<const Side*, 2> sides{&what.on, &what.off};
  std::vector<Player> players;
  for (std::size_t s = 0; s < 2; ++s) {
    players.emplace_back(what, *sides[s], n);
    const launch::Embedded& service = services.at(sides[s]->no_skip);
    if (Status status = players[s].open(service.endpoint(), s == 0 ? "on" : "off", parts); !status.ok())
      return service.explain(status);
  }
  std::array<Measured, 2> measured;
  std::vector<double> ratios;
  for (int turn = -kWarmUpTurns; turn < repeats; ++turn) {
    std::array<double, 2> seconds{};
    for (int k = 0; k < 2; ++k) {
      const auto s = static_cast<std::size_t>((turn + kWarmUpTurns + k) % 2);
      const auto took = players[s].turn((turn + kWarmUpTurns) % 2, measured[s].report);
      if (!took.ok()) return services.at(sides[s]->no_skip).explain(took.status());
      seconds[s] = *took;
      if (turn >= 0) measured[s].seconds.push_back(*took);
    }
    if (turn >= 0) ratios.push_back(seconds[1] / seconds[0]);
    if (Status status = compare(what, measured[0], measured[1]); !status.ok()) return status;
  }
  for (std::size_t s = 0; s < 2; ++s) {
    auto answer = players[s].answer();
    if (!answer.ok()) return answer.status();
    measured[s].answer = std::move(*answer);
  }
  if (Status status = compare(what, measured[0], measured[1]); !status.ok()) return status;
  for (std::size_t s = 0; s < 2; ++s) {
    Json row = row_of(what, *sides[s], s == 0, players[s], n, parts, ranks, measured[s]);
    row["off_over_on"] = median(ratios);
    row["same_answers"] = what.same_answers ? Json(true) : Json();
    rows.push_back(std::move(row));
    if (Status status = players[s].close(); !status.ok()) return status;
  }
  return {};
}

std::string skip_ms(const Json& row) { return fmt::format("{:.2f}", 1e3 * row["seconds"].get<double>()); }

std::string both(const Json& on, const Json& off, const char* field) {
  return on[field].dump() + " / " + off[field].dump();
}

// The rows come in pairs.
std::string skip_tables(const Json& rows) {
  std::string text;
  std::vector<std::vector<std::string>> lines;
  const auto title = [](const Json& row) {
    return fmt::format("{} parts, {} rank(s); milliseconds, the skip on / off", row["parts"].get<int>(),
                       row["ranks"].get<int>());
  };
  for (std::size_t k = 0; k + 1 < rows.size(); k += 2) {
    const Json& on = rows[k];
    const Json& off = rows[k + 1];
    if (k == 0 || title(on) != title(rows[k - 2])) {
      if (!lines.empty()) text += table(lines, 4);
      text += "\n" + title(on) + "\n";
      lines = {{"lacking", "work", "on", "off", "n", "on ms", "off ms", "off/on", "bytes", "scanned", "searched",
                "rounds", "answers"}};
    }
    lines.push_back({on["scene"], on["work"], on["variant"], off["variant"], on["n"].dump(), skip_ms(on), skip_ms(off),
                     fmt::format("{:.2f}", on["off_over_on"].get<double>()), both(on, off, "bytes"),
                     both(on, off, "scanned"), both(on, off, "searched"), both(on, off, "rounds"),
                     on["same_answers"].is_null() ? "-" : "same"});
  }
  if (!lines.empty()) text += table(lines, 4);
  return text;
}

bool wanted(const SkipsOptions& options, const Case& what) {
  return options.scenes.empty() ||
         std::find(options.scenes.begin(), options.scenes.end(), what.skip) != options.scenes.end();
}

Status check(const SkipsOptions& options) {
  OptionCheck check("rcb_bench skips");
  const auto cases = skip_cases();
  check.known("--scenes", options.scenes, [&cases](const std::string& scene) {
    return std::any_of(cases.begin(), cases.end(), [&scene](const Case& what) { return scene == what.skip; });
  });
  check.between("--parts", options.parts, 1, kPartsMax);
  check.between("--ranks", options.ranks, 1, kRanksMax);
  check.between("--repeats", std::vector{options.repeats}, 1, kRepeatsMax);
  check.whole("--points", {options.points}, 1, 1e9);
  return check.status();
}

// One service that skips all, and one for each thing that isn't to be skipped; while this program has one thread.
Status start_services(const SkipsOptions& options, int ranks, Services& services) {
  for (const Case& what : skip_cases()) {
    if (!wanted(options, what)) continue;
    for (const Side* side : {&what.on, &what.off}) {
      if (services.contains(side->no_skip)) continue;
      setenv(kVariable, side->no_skip, 1);
      auto service = launch::Embedded::start(ranks, [](double) {});
      unsetenv(kVariable);
      if (!service.ok()) return service.status();
      services.emplace(side->no_skip, std::move(*service));
    }
  }
  return {};
}

Status measure_all(const SkipsOptions& options, Json& rows) {
  for (const int ranks : options.ranks) {
    Services services;
    if (Status status = start_services(options, ranks, services); !status.ok()) return status;
    for (const int parts : options.parts)
      for (const Case& what : skip_cases()) {
        if (!wanted(options, what)) continue;
        fmt::print(stderr, "ranks {}, {} parts: {}\n", ranks, parts, name_of(what));
        const auto points = static_cast<std::size_t>(options.points);
        if (Status status = run_case(what, services, points, parts, ranks, options.repeats, rows); !status.ok())
          return status;
      }
  }
  return {};
}

}  // namespace

CLI::App* add_skips(CLI::App& app, SkipsOptions& options) {
  auto* command = app.add_subcommand("skips", "what is saved where a scene lacks something: each skip on and off");
  std::string names;
  for (const Case& what : skip_cases())
    if (names.find(what.skip) == std::string::npos) names += (names.empty() ? "" : ", ") + std::string(what.skip);
  add_list(*command, "--scenes", options.scenes, "what is lacking (default: all): " + names);
  add_list(*command, "--parts", options.parts, "numbers of parts");
  add_list(*command, "--ranks", options.ranks, "numbers of MPI ranks, services of their own");
  command->add_option("--repeats", options.repeats, "timed turns of each side")->capture_default_str();
  command->add_option("--points", options.points, "particles of every scene")->capture_default_str();
  command->add_option("--json", options.json, "write the result to this file");
  return command;
}

Status run_skips(const SkipsOptions& options, Json document) {
  if (Status status = check(options); !status.ok()) return status;
  document["rows"] = Json::array();
  const Status measured = measure_all(options, document["rows"]);
  print(skip_tables(document["rows"]));
  if (Status status = write_result(options.json, document); !status.ok()) return status;
  return measured;
}

}  // namespace rcb::bench
