#include "client/solvers/mpi/summary.hpp"

#include <algorithm>
#include <numeric>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "client/solvers/drive.hpp"

namespace rcb::solvers {
namespace {

using nlohmann::json;

// One value of all steps.
std::vector<double> by_step(const std::vector<Work>& work, double Work::*value, double divisor = 1) {
  std::vector<double> values;
  for (const Work& one : work) values.push_back(one.*value / divisor);
  return values;
}

double total(const std::vector<Work>& work, double Work::*value) {
  const std::vector<double> values = by_step(work, value);
  return std::accumulate(values.begin(), values.end(), 0.0);
}

}  // namespace

std::string summary(const MpiOptions& options, int processes, const MpiRecord& record) {
  return fmt::format(
      "slope_mpi: {} points on {} processes, {} steps of {:g} s in {} substeps, scene {} in {}\n"
      "  repartitions   {} (the first partition included)\n"
      "  handed over    {:.0f} points\n"
      "  shared nodes   {:.0f} a substep\n"
      "  computing      {:.3g} s, the slowest process of each step; {:.3g} s on average (processor time)\n"
      "  wall clock     {:.3g} s, {:.3g} s of it in service",
      options.slope.points, processes, options.steps, options.slope.interval, record.substeps, options.scene,
      parts_text(options.parts, record.reports), record.repartitions(), total(record.sum, &Work::handed_over),
      total(record.sum, &Work::shared_nodes) / static_cast<double>(std::max<std::uint64_t>(record.substeps, 1)),
      total(record.largest, &Work::computing), total(record.sum, &Work::computing) / processes,
      total(record.largest, &Work::wall), total(record.largest, &Work::service));
}

std::string json_document(const MpiOptions& options, int processes, const MpiRecord& record) {
  const Balance& start = record.physics.start;
  const Balance& end = record.physics.end;
  json document = run_json("slope_mpi", options, record);
  document.update({{"seats", processes},
                   {"method", options.method},
                   {"held", record.held},
                   {"handed_over", static_cast<std::uint64_t>(total(record.sum, &Work::handed_over))},
                   {"checked", options.check},
                   {"momentum", {{"start", start.momentum}, {"end", end.momentum}}},
                   {"energy", {{"start", start.energy()}, {"end", end.energy()}}},
                   {"by_step",
                    {{"wall", by_step(record.largest, &Work::wall)},
                     {"service", by_step(record.largest, &Work::service)},
                     {"slowest", by_step(record.largest, &Work::computing)},
                     {"mean", by_step(record.sum, &Work::computing, processes)},
                     {"shared_nodes", by_step(record.sum, &Work::shared_nodes)},
                     {"grid_bytes", by_step(record.sum, &Work::grid_bytes)},
                     {"handed_over", by_step(record.sum, &Work::handed_over)}}}});
  return document.dump();
}

}  // namespace rcb::solvers
