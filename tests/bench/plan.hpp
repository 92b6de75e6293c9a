// What one MPI job is to measure: the driver writes it, the job reads it.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "tests/bench/json.hpp"
#include "tests/bench/peers/contender.hpp"

namespace rcb::bench {

struct Cell {
  std::string scene;
  std::uint64_t n = 0;
  int parts = 1;

  bool operator==(const Cell&) const = default;
};

// A contender that gave no answer in a cell: it is left out there.
struct Skip {
  Cell cell;
  std::string tool;
  std::string method;

  bool operator==(const Skip&) const = default;
};

struct Plan {
  std::vector<Cell> cells;  // those with the same points stand together
  Wish wish;
  int repeats = 1;
  bool memory = false;  // measure peak memory too
  std::vector<Skip> skips;
};

Json json_of(const Skip& skip);
// Throws nlohmann::json::exception.
Skip skip_of(const Json& json);

Status save(const Plan& plan, const std::string& path);
Result<Plan> load(const std::string& path);

}  // namespace rcb::bench
