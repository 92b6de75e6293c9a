// The figure of an error history, drawn by gnuplot: error against step, the tolerance, repartitions as red dots.
#pragma once

#include <string>
#include <vector>

#include "client/cli/print/curve.hpp"
#include "common/base/status.hpp"

namespace rcb::cli {

// Writes an SVG, or a PNG if `path` ends in .png, under another name first, then renamed. Errors: not_found without
// gnuplot, io_error, deadline_exceeded.
Status plot_history(const std::string& path, const std::vector<Curve>& curves);

}  // namespace rcb::cli
