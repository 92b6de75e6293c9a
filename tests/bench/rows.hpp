// The rows of the result: one a contender and cell, with the ratios of ours to each peer taken within one run.
#pragma once

#include <vector>

#include "tests/bench/json.hpp"
#include "tests/bench/measure.hpp"
#include "tests/bench/plan.hpp"

namespace rcb::bench {

Json make_rows_json(const Cell& cell, int dims, int ranks, const std::vector<Measurement>& measured);

}  // namespace rcb::bench
