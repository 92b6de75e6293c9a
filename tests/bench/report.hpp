// What rcb_bench prints: tables for people, and the summary that says in few numbers how we stand.
#pragma once

#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "tests/bench/json.hpp"

namespace rcb::bench {

// By ranks, parts and peer: the median over the scenes of `ratio` on rcb's rows, and its largest (the worst for us).
Json summarise_static(const Json& rows);
// By ranks and tool: time per particle at most points over that at fewest; time at most parts over that at fewest.
Json summarise_scaling(const Json& rows);

std::string static_tables(const Json& document);
std::string scaling_tables(const Json& document);

// Aligned columns; the first `left` of them to the left.
std::string table(const std::vector<std::vector<std::string>>& lines, std::size_t left);

void print(const std::string& text);
// Through a file beside it and a rename. Errors: io_error.
Status write_file(const std::string& path, const std::string& text);
// The same of a bench's result; nothing where no path was given.
Status write_result(const std::string& path, const Json& document);

// internal if a run of ours failed, or if its hash isn't the same for every number of ranks.
Status verdict(const Json& document);

}  // namespace rcb::bench
