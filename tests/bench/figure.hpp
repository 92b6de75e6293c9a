// The figure: run time against largest relative error, every scene, method and tolerance a point.
#pragma once

#include <string>

#include "common/base/status.hpp"
#include "tests/bench/json.hpp"

namespace rcb::bench {

// Draws a `static` document: one panel a number of parts, at 2 ranks if they were run, else at the most. Writes `path`
// (SVG) and, beside it with .gp for its ending, what gnuplot was told. Errors: not_found without gnuplot, io_error.
Status draw(const Json& document, const std::string& path);

// Runs a script that names its own output. Errors: not_found without gnuplot, deadline_exceeded, internal.
Status run_gnuplot(const std::string& script_path);

}  // namespace rcb::bench
