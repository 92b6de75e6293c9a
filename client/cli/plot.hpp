// The figure of an error history: error against step, the tolerance, repartitions as red dots. Drawn by gnuplot.
#pragma once

#include <string>
#include <vector>

#include "client/cli/curve.hpp"
#include "common/base/status.hpp"

namespace rcb::cli {

// An SVG at `path`, written beside it and renamed. Errors: not_found without gnuplot, io_error, deadline_exceeded.
Status plot_history(const std::string& path, const std::vector<Curve>& curves);

}  // namespace rcb::cli
