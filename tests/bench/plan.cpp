#include "tests/bench/plan.hpp"

#include <fstream>

#include "tests/bench/json.hpp"

namespace rcb::bench {

namespace {

Json json_of(const Cell& cell) { return {{"scene", cell.scene}, {"n", cell.n}, {"parts", cell.parts}}; }

Cell cell_of(const Json& json) { return {json.at("scene"), json.at("n"), json.at("parts")}; }

}  // namespace

Json json_of(const Skip& skip) { return {{"cell", json_of(skip.cell)}, {"tool", skip.tool}, {"method", skip.method}}; }

Skip skip_of(const Json& json) { return {cell_of(json.at("cell")), json.at("tool"), json.at("method")}; }

Status save(const Plan& plan, const std::string& path) {
  Json cells = Json::array();
  for (const Cell& cell : plan.cells) cells.push_back(json_of(cell));
  Json skips = Json::array();
  for (const Skip& skip : plan.skips) skips.push_back(json_of(skip));
  const Json json{{"cells", cells},
                  {"methods", plan.wish.methods},
                  {"cut_tolerances", plan.wish.cut_tolerances},
                  {"migrate", plan.wish.migrate},
                  {"repeats", plan.repeats},
                  {"memory", plan.memory},
                  {"skips", skips}};
  std::ofstream out(path);
  out << json << "\n";
  out.close();
  if (!out) return {Code::io_error, path + ": can't be written"};
  return {};
}

Result<Plan> load(const std::string& path) {
  try {
    std::ifstream in(path);
    const Json json = Json::parse(in);
    Plan plan;
    for (const Json& cell : json.at("cells")) plan.cells.push_back(cell_of(cell));
    for (const Json& skip : json.at("skips")) plan.skips.push_back(skip_of(skip));
    plan.wish.methods = json.at("methods").get<std::vector<std::string>>();
    plan.wish.cut_tolerances = json.at("cut_tolerances").get<std::vector<double>>();
    plan.wish.migrate = json.at("migrate");
    plan.repeats = json.at("repeats");
    plan.memory = json.at("memory");
    return plan;
  } catch (const Json::exception& error) {
    return Status(Code::io_error, path + ": " + error.what());
  }
}

}  // namespace rcb::bench
