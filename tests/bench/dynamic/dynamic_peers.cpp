#include "tests/bench/dynamic/dynamic_peers.hpp"

#include <cmath>
#include <fstream>
#include <limits>
#include <utility>

#include <fmt/format.h>

#include "tests/bench/json.hpp"
#include "tests/bench/measure.hpp"
#include "tests/bench/worker.hpp"

namespace rcb::bench {
namespace {

constexpr std::pair<const char*, double DynamicRun::*> kNumbers[] = {
    {"seconds", &DynamicRun::seconds},
    {"seconds_search", &DynamicRun::seconds_search},
    {"seconds_migrate", &DynamicRun::seconds_migrate},
    {"seconds_exchange", &DynamicRun::seconds_exchange},
    {"seconds_client", &DynamicRun::seconds_client},
    {"seconds_round_trip", &DynamicRun::seconds_round_trip},
    {"seconds_first", &DynamicRun::seconds_first},
    {"seconds_lost", &DynamicRun::seconds_lost},
    {"arrival_mean", &DynamicRun::arrival_mean},
    {"arrival_max", &DynamicRun::arrival_max},
    {"error_mean", &DynamicRun::error_mean},
    {"error_max", &DynamicRun::error_max}};
constexpr std::pair<const char*, std::uint64_t DynamicRun::*> kCounts[] = {{"repartitions", &DynamicRun::repartitions},
                                                                           {"drifted", &DynamicRun::drifted},
                                                                           {"moved", &DynamicRun::moved},
                                                                           {"migrated", &DynamicRun::migrated}};

// JSON has no infinity.
Json tolerance_json(double tolerance) { return std::isinf(tolerance) ? Json("inf") : Json(tolerance); }
double tolerance_of(const Json& json) {
  return json.is_string() ? std::numeric_limits<double>::infinity() : json.get<double>();
}

// Collective.
Status run_along(comm::Comm& comm, const std::string& plan_path, const std::string& rows_path) {
  const auto plan = load_peer_plan(plan_path);
  if (!comm::agree(comm, plan.ok())) return plan.status();
  std::ofstream rows;
  if (comm.rank() == 0) rows.open(rows_path);
  for (const int parts : plan->parts)
    for (std::size_t k = 0; k < plan->tolerances.size(); ++k) {
      const double tolerance = plan->tolerances[(k + static_cast<std::size_t>(plan->repeat)) % plan->tolerances.size()];
      const auto reader = io::open_trajectory(plan->trajectory.path, {});
      if (!comm::agree(comm, reader.ok())) return reader.status();
      const auto run = drive_zoltan(comm, **reader, plan->trajectory, parts, tolerance);
      if (!comm::agree(comm, run.ok())) return run.status();
      if (comm.rank() == 0) rows << json_of(PeerRun{parts, tolerance, *run}) << std::endl;
    }
  if (comm.rank() == 0) rows.close();
  if (!comm::agree(comm, !rows.fail())) return {Code::io_error, rows_path + ": can't be written"};
  return {};
}

}  // namespace

Status save(const PeerPlan& plan, const std::string& path) {
  Json tolerances = Json::array();
  for (const double tolerance : plan.tolerances) tolerances.push_back(tolerance_json(tolerance));
  const Json json{{"scene", plan.trajectory.scene},
                  {"points", plan.trajectory.points},
                  {"path", plan.trajectory.path},
                  {"solver_seconds", plan.trajectory.solver_seconds},
                  {"parts", plan.parts},
                  {"tolerances", tolerances},
                  {"repeat", plan.repeat}};
  std::ofstream out(path);
  out << json << "\n";
  out.close();
  if (!out) return {Code::io_error, path + ": can't be written"};
  return {};
}

Result<PeerPlan> load_peer_plan(const std::string& path) {
  try {
    std::ifstream in(path);
    const Json json = Json::parse(in);
    PeerPlan plan;
    plan.trajectory = {json.at("scene"), json.at("points"), json.at("path"),
                       json.at("solver_seconds").get<std::vector<double>>()};
    plan.parts = json.at("parts").get<std::vector<int>>();
    for (const Json& tolerance : json.at("tolerances")) plan.tolerances.push_back(tolerance_of(tolerance));
    plan.repeat = json.at("repeat");
    return plan;
  } catch (const Json::exception& error) {
    return Status(Code::io_error, path + ": " + error.what());
  }
}

Json json_of(const PeerRun& run) {
  Json json{{"parts", run.parts}, {"tolerance", tolerance_json(run.tolerance)}, {"steps", run.run.steps}};
  for (const auto& [name, member] : kNumbers) json[name] = run.run.*member;
  for (const auto& [name, member] : kCounts) json[name] = run.run.*member;
  return json;
}

PeerRun peer_run_of(const Json& json) {
  PeerRun run{json.at("parts"), tolerance_of(json.at("tolerance")), {}};
  run.run.steps = json.at("steps").get<std::vector<StepTimes>>();
  for (const auto& [name, member] : kNumbers) run.run.*member = json.at(name);
  for (const auto& [name, member] : kCounts) run.run.*member = json.at(name);
  return run;
}

int run_peer_worker(int argc, char** argv) {
  keep_freed_memory();
  return run_as_rank(argc, argv, "rcb_bench", run_along);
}

#ifdef RCB_BENCH_ZOLTAN
bool has_dynamic_peer() { return true; }
#else
bool has_dynamic_peer() { return false; }

Result<DynamicRun> drive_zoltan(comm::Comm&, io::TrajectoryReader&, const Trajectory&, int, double) {
  return Status(Code::unsupported, "this build has no Zoltan");
}
#endif

}  // namespace rcb::bench
