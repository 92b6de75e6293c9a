// The table and the figure of rcb_bench dynamic.
#pragma once

#include <string>

#include <nlohmann/json.hpp>

#include "common/base/status.hpp"

namespace rcb::bench {

std::string dynamic_tables(const nlohmann::ordered_json& document);

// Time in service against mean error, a point a tolerance, a panel a scene; at the first numbers of parts and ranks.
// Writes `path` (SVG) and, beside it with .gp for its ending, what gnuplot was told. Errors: as draw().
Status draw_dynamic(const nlohmann::ordered_json& document, const std::string& path);

}  // namespace rcb::bench
