#include "server/scene/report.hpp"

namespace rcb::scene {

const char* name_of(Way way) {
  switch (way) {
    case Way::sockets:
      return "sockets";
    case Way::shared_memory:
      return "shared-memory";
    case Way::file:
      return "file";
    case Way::count:
      return "count";
    case Way::endpoint:
      break;
  }
  return "endpoint";
}

std::vector<std::string> Skips::names() const {
  constexpr const char* kNames[] = {"dimension", "weights", "ids",           "double precision",
                                    "exchange",  "search",  "far from cuts", "positions"};
  std::vector<std::string> names;
  for (unsigned k = 0; k < std::size(kNames); ++k)
    if ((bits_ >> k & 1U) != 0) names.emplace_back(kNames[k]);
  return names;
}

StepSeconds& StepSeconds::operator+=(const StepSeconds& other) {
  receive += other.receive;
  exchange += other.exchange;
  search += other.search;
  migrate += other.migrate;
  total += other.total;
  return *this;
}

StepCounts& StepCounts::operator+=(const StepCounts& other) {
  bytes += other.bytes;
  drifted += other.drifted;
  moved += other.moved;
  migrated += other.migrated;
  scanned += other.scanned;
  searched += other.searched;
  rounds += other.rounds;
  reductions += other.reductions;
  seconds += other.seconds;
  return *this;
}

wire::Json to_json(const StepCounts& counts) {
  wire::Json json = wire::Json::object();
  json["bytes"] = counts.bytes;
  json["drifted"] = counts.drifted;
  json["moved"] = counts.moved;
  json["migrated"] = counts.migrated;
  json["scanned"] = counts.scanned;
  json["searched"] = counts.searched;
  json["rounds"] = counts.rounds;
  json["reductions"] = counts.reductions;
  wire::Json& seconds = json["seconds"];
  seconds["receive"] = counts.seconds.receive;
  seconds["exchange"] = counts.seconds.exchange;
  seconds["search"] = counts.seconds.search;
  seconds["migrate"] = counts.seconds.migrate;
  seconds["total"] = counts.seconds.total;
  return json;
}

// Field by field, since a list of all would be copied: it is done at each step.
wire::Json to_json(const StepReport& report) {
  wire::Json json = to_json(static_cast<const StepCounts&>(report));
  json["scene"] = report.scene;
  json["step"] = report.step;
  json["epoch"] = report.epoch;
  json["n"] = report.n;
  json["parts"] = report.parts;
  json["error_before"] = wire::or_null(report.error_before);
  json["error"] = report.error;
  json["imbalance"] = report.imbalance;
  json["repartitioned"] = report.repartitioned;
  json["reason"] = report.reason;
  json["axes_flipped"] = report.axes_flipped;
  json["inserted"] = report.inserted;
  json["removed"] = report.removed;
  json["skipped"] = report.skipped.names();
  json["way"] = name_of(report.way);
  json["sent"] = report.sent();
  json["positions_step"] = wire::or_null(report.positions_step);
  json["strangers"] = report.strangers;
  if (!report.drifted_known) json["drifted"] = nullptr;
  if (report.weights_as_zero > 0) json["weights_as_zero"] = report.weights_as_zero;
  return json;
}

}  // namespace rcb::scene
