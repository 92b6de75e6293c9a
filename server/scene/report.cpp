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

Way way_from_name(std::string_view name) {
  for (const Way way : {Way::sockets, Way::shared_memory, Way::file, Way::count})
    if (name == name_of(way)) return way;
  return Way::endpoint;
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
  const StepSeconds& seconds = counts.seconds;
  return {{"bytes", counts.bytes},
          {"drifted", counts.drifted},
          {"moved", counts.moved},
          {"migrated", counts.migrated},
          {"scanned", counts.scanned},
          {"searched", counts.searched},
          {"rounds", counts.rounds},
          {"reductions", counts.reductions},
          {"seconds",
           {{"receive", seconds.receive},
            {"exchange", seconds.exchange},
            {"search", seconds.search},
            {"migrate", seconds.migrate},
            {"total", seconds.total}}}};
}

wire::Json to_json(const StepReport& report) {
  wire::Json json = to_json(static_cast<const StepCounts&>(report));
  json.update({{"scene", report.scene},
               {"step", report.step},
               {"epoch", report.epoch},
               {"n", report.n},
               {"parts", report.parts},
               {"error_before", report.error_before ? wire::Json(*report.error_before) : wire::Json(nullptr)},
               {"error", report.error},
               {"imbalance", report.imbalance},
               {"repartitioned", report.repartitioned},
               {"reason", report.reason},
               {"axes_flipped", report.axes_flipped},
               {"inserted", report.inserted},
               {"removed", report.removed},
               {"skipped", report.skipped.names()},
               {"way", name_of(report.way)},
               {"sent", report.sent()},
               {"positions_step", report.positions_step ? wire::Json(*report.positions_step) : wire::Json()},
               {"strangers", report.strangers}});
  if (!report.drifted_known) json["drifted"] = nullptr;
  if (report.weights_as_zero > 0) json["weights_as_zero"] = report.weights_as_zero;
  return json;
}

}  // namespace rcb::scene
