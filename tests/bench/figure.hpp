// The figure: run time against largest relative error, every scene, method and tolerance a point.
#pragma once

#include <string>

#include "common/base/status.hpp"
#include "tests/bench/json.hpp"

namespace rcb::bench {

// Draws a `static` document: one panel a number of parts, at 2 ranks if they were run, else at the most. Writes `path`
// (SVG) and, beside it with .gp for its ending, what gnuplot was told. Errors: not_found without gnuplot, io_error.
Status draw(const Json& document, const std::string& path);

// What every figure of a bench begins with.
std::string figure_head(double width, const std::string& output);
// Writes the script beside its output, with .gp for .svg, and runs it. Errors: io_error, not_found without gnuplot,
// deadline_exceeded, internal.
Status plot(const std::string& script, const std::string& output);
// Whether gnuplot's script can name this output. Errors: invalid_argument.
Status check_output(const std::string& path);

}  // namespace rcb::bench
