// The table and the figure of rcb_bench dynamic.
#pragma once

#include <string>

#include "common/base/status.hpp"
#include "tests/bench/json.hpp"

namespace rcb::bench {

std::string dynamic_tables(const Json& document);

// What a solver waits against mean error, a point a tolerance, a panel a scene; at the first numbers of parts and
// ranks. Writes `path` (SVG) and, beside it with .gp for its ending, what gnuplot was told. Errors: as draw().
Status draw_dynamic(const Json& document, const std::string& path);

}  // namespace rcb::bench
