#include "tests/bench/step/idle.hpp"

#include <algorithm>
#include <array>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <thread>

#include <fmt/format.h>

#include "client/launch/launch.hpp"
#include "client/lib/client.hpp"
#include "common/base/clock.hpp"
#include "tests/bench/driver.hpp"
#include "tests/bench/json.hpp"
#include "tests/bench/options.hpp"
#include "tests/bench/report.hpp"
#include "tests/bench/scenes.hpp"
#include "tests/bench/step/process_memory.hpp"

namespace rcb::bench {
namespace {

constexpr double kSecondsMax = 86400;
constexpr int kQueriesMax = 1'000'000;

struct Query {
  const char* command;
  const char* arguments;
};
constexpr std::array<Query, 5> kQueries{{{"status", "{}"},
                                         {"error", R"({"scene":"idle"})"},
                                         {"counts", R"({"scene":"idle"})"},
                                         {"owner", R"({"scene":"idle","position":[0.3,0.6,0.9],"id":7})"},
                                         {"box", R"({"scene":"idle","lo":[0.1,0.1,0.1],"hi":[0.2,0.2,0.2]})"}}};

// Of all threads, since each began.
double cpu_seconds(const std::vector<pid_t>& pids) {
  double nanoseconds = 0;
  for (const pid_t pid : pids) {
    std::error_code ignored;
    for (const auto& task : std::filesystem::directory_iterator(fmt::format("/proc/{}/task", pid), ignored)) {
      std::ifstream in(task.path() / "schedstat");
      double own = 0;
      if (in >> own) nanoseconds += own;
    }
  }
  return 1e-9 * nanoseconds;
}

// Asleep, but for looking whether the user has had enough.
Status wait(double seconds) {
  const SteadyClock clock;
  for (const double end = clock.seconds() + seconds; clock.seconds() < end;) {
    if (interrupted()) return {Code::aborted, "interrupted"};
    std::this_thread::sleep_for(std::chrono::duration<double>(std::min(0.1, seconds)));
  }
  return {};
}

Status push_once(client::Client& client, std::uint64_t n, int parts) {
  client::SceneOptions scene_options;
  scene_options.parts = parts;
  if (Status status = client.create_scene("idle", scene_options); !status.ok()) return status;
  auto scene = client.open_scene("idle");
  if (!scene.ok()) return scene.status();
  const particles::ParticleSet set = make_rows(*find_scene_kind("uniform"), n, 0, n);
  const std::array<const double*, 3> axes{set.position[0].data(), set.position[1].data(), set.position[2].data()};
  auto result = scene->step(client::Positions::axes(axes, n));
  return result.ok() ? Status{} : result.status();
}

Status measure(const IdleOptions& options, int ranks, Json& rows) {
  auto service = launch::Embedded::start(ranks, [](double) {});
  if (!service.ok()) return service.status();
  const auto body = [&]() -> Status {
    std::vector<pid_t> pids = descendants("rcbd");
    if (pids.size() != static_cast<std::size_t>(ranks))
      return {Code::internal, fmt::format("{} processes rcbd of {}", pids.size(), ranks)};
    const std::vector<pid_t> launchers = descendants("mpirun");
    pids.insert(pids.end(), launchers.begin(), launchers.end());
    client::ConnectOptions connect;
    connect.endpoint = service->endpoint();
    auto client = client::Client::connect(connect);
    if (!client.ok()) return client.status();
    const auto n = static_cast<std::uint64_t>(options.points);
    if (Status status = push_once(*client, n, ranks); !status.ok()) return status;
    if (Status status = wait(1); !status.ok()) return status;  // what the step left behind
    const SteadyClock clock;
    const double before = cpu_seconds(pids);
    const double start = clock.seconds();
    if (Status status = wait(options.seconds); !status.ok()) return status;
    const double cpu = cpu_seconds(pids) - before;
    const double seconds = clock.seconds() - start;
    Json latencies = Json::object();
    std::array<std::vector<double>, kQueries.size()> took;
    for (int k = 0; k < options.queries; ++k)
      for (std::size_t q = 0; q < kQueries.size(); ++q) {
        if (interrupted()) return {Code::aborted, "interrupted"};
        const double asked = clock.seconds();
        const auto reply = client->call(kQueries[q].command, kQueries[q].arguments);
        if (!reply.ok()) return reply.status();
        took[q].push_back(clock.seconds() - asked);
      }
    for (std::size_t q = 0; q < kQueries.size(); ++q) {
      std::sort(took[q].begin(), took[q].end());
      latencies[kQueries[q].command] = {{"median", took[q][took[q].size() / 2]}, {"most", took[q].back()}};
    }
    rows.push_back({{"scene", "uniform"},
                    {"n", n},
                    {"dims", 3},
                    {"parts", ranks},
                    {"ranks", ranks},
                    {"tool", "rcbd"},
                    {"method", "rcb"},
                    {"work", "idle"},
                    {"cut_tolerance", 0.0},
                    {"processes", pids.size()},
                    {"seconds", seconds},
                    {"seconds_cpu", cpu},
                    {"share_of_a_core", cpu / seconds},
                    {"seconds_of_a_query", latencies},
                    {"ratio", Json::object()}});
    return {};
  };
  return service->explain(body());
}

std::string idle_table(const Json& rows) {
  std::vector<std::vector<std::string>> lines{{"ranks", "processes", "idle s", "CPU s", "of a core"}};
  for (const Query& query : kQueries) lines[0].push_back(fmt::format("{} ms", query.command));
  for (const Json& row : rows) {
    lines.push_back({row["ranks"].dump(), row["processes"].dump(), fmt::format("{:.1f}", row["seconds"].get<double>()),
                     fmt::format("{:.4f}", row["seconds_cpu"].get<double>()),
                     fmt::format("{:.3f} %", 100 * row["share_of_a_core"].get<double>())});
    for (const Query& query : kQueries)
      lines.back().push_back(
          fmt::format("{:.2f}", 1e3 * row["seconds_of_a_query"][query.command]["median"].get<double>()));
  }
  return table(lines, 0) + "CPU of all processes together; queries: the median from the call to the answer\n";
}

Status check(const IdleOptions& options) {
  OptionCheck check("rcb_bench idle");
  check.between("--ranks", options.ranks, 1, kRanksMax);
  check.holds(options.seconds > 0 && options.seconds <= kSecondsMax, "--seconds takes a number from 0 to 86400");
  check.between("--queries", std::vector{options.queries}, 1, kQueriesMax);
  check.whole("--points", {options.points}, 1, 1e9);
  return check.status();
}

}  // namespace

CLI::App* add_idle(CLI::App& app, IdleOptions& options) {
  auto* command = app.add_subcommand("idle", "CPU time while the client is silent, and how long queries take then");
  add_list(*command, "--ranks", options.ranks, "numbers of MPI ranks, one service each");
  command->add_option("--seconds", options.seconds, "of silence")->capture_default_str();
  command->add_option("--queries", options.queries, "of each kind")->capture_default_str();
  command->add_option("--points", options.points, "particles that the service holds")->capture_default_str();
  command->add_option("--json", options.json, "write the result to this file");
  return command;
}

Status run_idle(const IdleOptions& options, Json document) {
  if (Status status = check(options); !status.ok()) return status;
  Json rows = Json::array();
  Status status;
  for (const int ranks : options.ranks)
    if (status.ok()) status = measure(options, ranks, rows);
  print(idle_table(rows));
  document["rows"] = std::move(rows);
  if (Status written = write_result(options.json, document); !written.ok()) return written;
  return status;
}

}  // namespace rcb::bench
