// What rcb_bench prints: tables for people, and the summary that says in few numbers how we stand.
#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "common/base/status.hpp"

namespace rcb::bench {

// By ranks, parts and peer: the median over the scenes of `ratio` on rcb's rows, and its largest (the worst for us).
nlohmann::ordered_json summarise_static(const nlohmann::ordered_json& rows);
// By ranks and tool: time per particle at most points over that at fewest; time at most parts over that at fewest.
nlohmann::ordered_json summarise_scaling(const nlohmann::ordered_json& rows);

std::string static_tables(const nlohmann::ordered_json& document);
std::string scaling_tables(const nlohmann::ordered_json& document);

// Aligned columns; the first `left` of them to the left.
std::string table(const std::vector<std::vector<std::string>>& lines, std::size_t left);

void print(const std::string& text);
// Through a file beside it and a rename. Errors: io_error.
Status write_file(const std::string& path, const std::string& text);
// The same of a bench's result; nothing where no path was given.
Status write_result(const std::string& path, const nlohmann::ordered_json& document);

// internal if a run of ours failed, or if its hash isn't the same for every number of ranks.
Status verdict(const nlohmann::ordered_json& document);

}  // namespace rcb::bench
