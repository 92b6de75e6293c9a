// What one MPI job is to measure: the driver writes it, the job reads it.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "tests/bench/contender.hpp"

namespace rcb::bench {

struct Cell {
  std::string scene;
  std::uint64_t n = 0;
  int parts = 1;
};

struct Plan {
  std::vector<Cell> cells;  // those with the same points stand together
  Wish wish;
  int repeats = 1;
  bool memory = false;  // measure peak memory too
};

Status save(const Plan& plan, const std::string& path);
Result<Plan> load(const std::string& path);

}  // namespace rcb::bench
