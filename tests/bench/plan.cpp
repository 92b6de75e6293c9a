#include "tests/bench/plan.hpp"

#include <fstream>

#include <nlohmann/json.hpp>

namespace rcb::bench {

using Json = nlohmann::json;

Status save(const Plan& plan, const std::string& path) {
  Json cells = Json::array();
  for (const Cell& cell : plan.cells) cells.push_back({{"scene", cell.scene}, {"n", cell.n}, {"parts", cell.parts}});
  const Json json{{"cells", cells},
                  {"methods", plan.wish.methods},
                  {"cut_tolerances", plan.wish.cut_tolerances},
                  {"migrate", plan.wish.migrate},
                  {"repeats", plan.repeats},
                  {"memory", plan.memory}};
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
    for (const Json& cell : json.at("cells")) plan.cells.push_back({cell.at("scene"), cell.at("n"), cell.at("parts")});
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
