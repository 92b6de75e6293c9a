#include "server/service/scene/report.hpp"

namespace rcb::service {

std::vector<std::string> Skips::names() const {
  constexpr const char* kNames[] = {"dimension", "weights",  "ids",    "double precision",
                                    "motion",    "exchange", "search", "far from cuts"};
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

wire::Json to_json(const StepSeconds& seconds) {
  return {{"receive", seconds.receive},
          {"exchange", seconds.exchange},
          {"search", seconds.search},
          {"migrate", seconds.migrate},
          {"total", seconds.total}};
}

wire::Json to_json(const StepReport& report) {
  wire::Json json{{"scene", report.scene},
                  {"step", report.step},
                  {"epoch", report.epoch},
                  {"n", report.n},
                  {"parts", report.parts},
                  {"scene_recreated", report.scene_recreated},
                  {"error_before", report.error_before ? wire::Json(*report.error_before) : wire::Json(nullptr)},
                  {"error", report.error},
                  {"imbalance", report.imbalance},
                  {"repartitioned", report.repartitioned},
                  {"reason", report.reason},
                  {"axes_flipped", report.axes_flipped},
                  {"drifted", report.drifted},
                  {"moved", report.moved},
                  {"migrated", report.migrated},
                  {"inserted", report.inserted},
                  {"removed", report.removed},
                  {"scanned", report.scanned},
                  {"searched", report.searched},
                  {"rounds", report.rounds},
                  {"reductions", report.reductions},
                  {"skipped", report.skipped.names()},
                  {"bytes", report.bytes},
                  {"way", api::name_of(report.way)},
                  {"seconds", to_json(report.seconds)}};
  if (report.first_id) json["first_id"] = *report.first_id;
  return json;
}

}  // namespace rcb::service
