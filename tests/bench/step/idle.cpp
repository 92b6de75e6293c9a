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
constexpr int kCountsMax = 100'000'000;

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

struct Cost {
  double seconds = 0, cpu = 0, others_cpu = 0;  // CPU of `pids`, and of `others`
};

template <typename Work>
Result<Cost> cost_of(const std::vector<pid_t>& pids, const std::vector<pid_t>& others, const Work& work) {
  const SteadyClock clock;
  const double start = clock.seconds(), cpu = cpu_seconds(pids), others_cpu = cpu_seconds(others);
  if (Status status = work(); !status.ok()) return status;
  return Cost{clock.seconds() - start, cpu_seconds(pids) - cpu, cpu_seconds(others) - others_cpu};
}

Result<std::vector<pid_t>> ranks_but_0(client::Client& client) {
  const auto status = client.call("status", "{}");
  if (!status.ok()) return status.status();
  std::vector<pid_t> pids;
  const Json told = Json::parse(status->json);
  for (const Json& host : told.at("hosts"))
    if (host["rank"] != 0) pids.push_back(host["pid"].get<pid_t>());
  return pids;
}

// Steps of particles at rest.
Status step(client::Scene& scene, const particles::ParticleSet& set, int steps) {
  const std::array<const double*, 3> axes{set.position[0].data(), set.position[1].data(), set.position[2].data()};
  for (int k = 0; k < steps; ++k) {
    if (interrupted()) return {Code::aborted, "interrupted"};
    const auto result = scene.step(client::Positions::axes(axes, set.count()));
    if (!result.ok()) return result.status();
    if (result->report.step > 0 && result->report.sent) return {Code::internal, "a step of particles at rest was sent"};
  }
  return {};
}

Result<Json> ask(client::Client& client, int times) {
  const SteadyClock clock;
  std::array<std::vector<double>, kQueries.size()> took;
  for (int k = 0; k < times; ++k)
    for (std::size_t q = 0; q < kQueries.size(); ++q) {
      if (interrupted()) return Status{Code::aborted, "interrupted"};
      const double asked = clock.seconds();
      const auto reply = client.call(kQueries[q].command, kQueries[q].arguments);
      if (!reply.ok()) return reply.status();
      took[q].push_back(clock.seconds() - asked);
    }
  Json latencies = Json::object();
  for (std::size_t q = 0; q < kQueries.size(); ++q) {
    std::sort(took[q].begin(), took[q].end());
    latencies[kQueries[q].command] = {{"median", took[q][took[q].size() / 2]}, {"most", took[q].back()}};
  }
  return latencies;
}

Status measure_here(const IdleOptions& options, int ranks, const std::string& endpoint, Json& rows) {
  std::vector<pid_t> pids = descendants("rcbd");
  if (pids.size() != static_cast<std::size_t>(ranks))
    return {Code::internal, fmt::format("{} processes rcbd of {}", pids.size(), ranks)};
  const std::vector<pid_t> launchers = descendants("mpirun");
  pids.insert(pids.end(), launchers.begin(), launchers.end());
  client::ConnectOptions connect;
  connect.endpoint = endpoint;
  auto client = client::Client::connect(connect);
  if (!client.ok()) return client.status();
  const auto others = ranks_but_0(*client);
  if (!others.ok()) return others.status();
  client::SceneOptions scene_options{.parts = ranks};
  scene_options.positions = "when-needed";
  if (Status status = client->create_scene("idle", scene_options); !status.ok()) return status;
  auto scene = client->open_scene("idle");
  if (!scene.ok()) return scene.status();
  const auto n = static_cast<std::uint64_t>(options.points);
  const particles::ParticleSet set = make_rows(*find_scene_kind("uniform"), n, 0, n);
  if (Status status = step(*scene, set, 1); !status.ok()) return status;
  if (Status status = wait(1); !status.ok()) return status;  // what the step left behind
  const auto silent = cost_of(pids, *others, [&] { return wait(options.seconds); });
  if (!silent.ok()) return silent.status();
  const auto counting = cost_of(pids, *others, [&] { return step(*scene, set, options.counts); });
  if (!counting.ok()) return counting.status();
  auto latencies = ask(*client, options.queries);
  if (!latencies.ok()) return latencies.status();
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
                  {"seconds", silent->seconds},
                  {"seconds_cpu", silent->cpu},
                  {"share_of_a_core", silent->cpu / silent->seconds},
                  {"share_of_ranks_but_0", silent->others_cpu / silent->seconds},
                  {"counts", options.counts},
                  {"seconds_of_counts", counting->seconds},
                  {"share_of_ranks_but_0_in_counts", counting->others_cpu / counting->seconds},
                  {"seconds_of_a_query", *latencies},
                  {"ratio", Json::object()}});
  return {};
}

Status measure(const IdleOptions& options, int ranks, Json& rows) {
  auto service = launch::Embedded::start(ranks, [](double) {});
  if (!service.ok()) return service.status();
  return service->explain(measure_here(options, ranks, service->endpoint(), rows));
}

std::string idle_table(const Json& rows) {
  std::vector<std::vector<std::string>> lines{
      {"ranks", "processes", "idle s", "CPU s", "of a core", "ranks but 0", "in counts"}};
  for (const Query& query : kQueries) lines[0].push_back(fmt::format("{} ms", query.command));
  for (const Json& row : rows) {
    lines.push_back({row["ranks"].dump(), row["processes"].dump(), fmt::format("{:.1f}", row["seconds"].get<double>()),
                     fmt::format("{:.4f}", row["seconds_cpu"].get<double>()),
                     fmt::format("{:.3f} %", 100 * row["share_of_a_core"].get<double>()),
                     fmt::format("{:.3f} %", 100 * row["share_of_ranks_but_0"].get<double>()),
                     fmt::format("{:.3f} %", 100 * row["share_of_ranks_but_0_in_counts"].get<double>())});
    for (const Query& query : kQueries)
      lines.back().push_back(
          fmt::format("{:.2f}", 1e3 * row["seconds_of_a_query"][query.command]["median"].get<double>()));
  }
  return table(lines, 0) +
         "CPU of all processes together; of the ranks but 0, while silent and while the solver steps by counts; "
         "queries: "
         "the median from the call to the answer\n";
}

Status check(const IdleOptions& options) {
  OptionCheck check("rcb_bench idle");
  check.between("--ranks", options.ranks, 1, kRanksMax);
  check.holds(options.seconds > 0 && options.seconds <= kSecondsMax, "--seconds takes a number from 0 to 86400");
  check.between("--queries", std::vector{options.queries}, 1, kQueriesMax);
  check.between("--counts", std::vector{options.counts}, 1, kCountsMax);
  check.whole("--points", {options.points}, 1, 1e9);
  return check.status();
}

}  // namespace

CLI::App* add_idle(CLI::App& app, IdleOptions& options) {
  auto* command = app.add_subcommand("idle", "CPU time while the client is silent, and how long queries take then");
  add_list(*command, "--ranks", options.ranks, "numbers of MPI ranks, one service each");
  command->add_option("--seconds", options.seconds, "of silence")->capture_default_str();
  command->add_option("--queries", options.queries, "of each kind")->capture_default_str();
  command->add_option("--counts", options.counts, "steps by counts, after the silence")->capture_default_str();
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
