// The output at the end of a run: the JSON document, or a few lines for people.
#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "client/solvers/drive.hpp"

namespace rcb::solvers {
namespace {

using nlohmann::json;

std::string text_of(const json& document) { return document.dump(-1, ' ', false, json::error_handler_t::replace); }

json momentum_json(const PhysicsCheck& physics) {
  return {{"start", physics.start.momentum},
          {"end", physics.end.momentum},
          {"impulse", physics.impulse},
          {"drift", physics.momentum_drift}};
}

json energy_json(const PhysicsCheck& physics) {
  return {{"start", physics.start.energy()},   {"end", physics.end.energy()},    {"largest", physics.energy_largest},
          {"growth", physics.energy_growth},   {"kinetic", physics.end.kinetic}, {"elastic", physics.end.elastic},
          {"potential", physics.end.potential}};
}

// The front lies a little inside the body, so the run-out is the difference between its places at the end and at the
// start.
json runout_json(const RunRecord& record) {
  if (!record.runout) return {};
  const auto& [length, start, end] = *record.runout;
  return {{"length", length}, {"front_start", start}, {"front_end", end}, {"relative", (end - start) / length}};
}

}  // namespace

std::string failure_document(const Status& status) {
  return text_of({{"failure",
                   {{"code", code_name(status.code())},
                    {"message", status.message()},
                    {"hint", status.hint()},
                    {"exit", exit_code(status.code())}}}});
}

json run_json(const std::string& solver, const RunOptions& options, const RunRecord& record) {
  json reports = json::array();
  for (const client::StepReport& report : record.reports) {
    json parsed = json::parse(report.json, nullptr, false);
    reports.push_back(parsed.is_discarded() ? json() : std::move(parsed));
  }
  const auto largest = record.largest_error();
  return {{"scene", options.scene},
          {"solver", solver},
          {"points", options.points},
          {"steps", options.steps},
          {"parts", options.parts},
          {"tolerance", std::isinf(options.tolerance) ? json("inf") : json(options.tolerance)},
          {"policy", options.policy},
          {"positions", options.positions},
          {"repartitions", options.no_service ? json() : json(record.repartitions())},
          {"error_max", largest ? json(largest->error) : json()},
          {"error_max_step", largest ? json(largest->step) : json()},
          {"reports", std::move(reports)},
          {"substeps", record.substeps}};
}

std::string json_document(const Program& program, const RunOptions& options, const RunRecord& record) {
  json document = run_json(program.name, options, record);
  document.update({{"momentum", momentum_json(record.physics)},
                   {"energy", energy_json(record.physics)},
                   {"runout", runout_json(record)},
                   {"seconds", {{"physics", record.seconds_physics}, {"service", record.seconds_service}}}});
  return text_of(document);
}

std::string parts_text(int asked, const std::vector<client::StepReport>& reports) {
  const int last = reports.empty() ? asked : reports.back().parts;
  return last == asked ? fmt::format("{} parts", asked) : fmt::format("{} parts ({} at the end)", asked, last);
}

std::string summary(const Program& program, const RunOptions& options, double interval, const RunRecord& record) {
  const double frames = static_cast<double>(record.steps_done + 1);
  std::string text = fmt::format("{}: {} points, {} steps of {:g} s in {} substeps", program.name, options.points,
                                 options.steps, interval, record.substeps);
  if (!options.no_service) {
    text += fmt::format(", scene {} in {}, tolerance {:g}", options.scene, parts_text(options.parts, record.reports),
                        options.tolerance);
    if (options.policy != RunOptions{}.policy) text += ", policy " + options.policy;
    if (options.positions != RunOptions{}.positions) text += ", positions " + options.positions;
  }
  text += '\n';
  if (const auto largest = record.largest_error()) {
    text += fmt::format("  repartitions   {} (the first partition included)\n", record.repartitions());
    text += fmt::format("  largest error  {:.4g} at step {}, before new cuts if it got any\n", largest->error,
                        largest->step);
    text += fmt::format("  in service     {:.3g} ms a step on average\n", 1e3 * record.seconds_service / frames);
  }
  const PhysicsCheck& physics = record.physics;
  text += fmt::format("  in physics     {:.3g} ms a step on average\n", 1e3 * record.seconds_physics / frames);
  text += fmt::format("  momentum       conserved to {:.1e} of the sum of mass times speed\n", physics.momentum_drift);
  text += fmt::format("  energy         {:.6g} J at the start, {:.6g} J at the end, never more than {:.6g} J",
                      physics.start.energy(), physics.end.energy(), physics.energy_largest);
  if (record.runout)
    text += fmt::format("\n  run-out        {:.4g} m, {:.3g} of the initial length of {:g} m",
                        record.runout->end - record.runout->start,
                        (record.runout->end - record.runout->start) / record.runout->length, record.runout->length);
  if (!options.trajectory.empty()) text += fmt::format("\n  trajectory     {}", options.trajectory);
  return text;
}

}  // namespace rcb::solvers
