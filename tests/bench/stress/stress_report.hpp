// What rcb_stress found, as a table, and whether anything of ours is wrong.
#pragma once

#include <string>

#include "common/base/status.hpp"
#include "tests/bench/json.hpp"

namespace rcb::bench {

// Gives every row `same_on_all_ranks`: null with one number of ranks, else whether the parts were the same on all.
void compare_ranks(Json& rows);

// A line a scene, size and number of parts; the worst over the numbers of ranks.
std::string stress_table(const Json& document);

// internal, naming the first row of ours that isn't as exact as the quotas, or not the same on all ranks, whose owners
// differ from its parts, or that took more rounds than promised.
Status stress_verdict(const Json& document);

}  // namespace rcb::bench
