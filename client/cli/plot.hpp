// The figure of an error history: error against step, the tolerance, repartitions as red dots. Drawn by gnuplot.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "common/base/status.hpp"

namespace rcb::cli {

struct Curve {
  std::string name;
  std::optional<double> tolerance;  // none: inf
  nlohmann::ordered_json reports;   // an array of step reports
};

// An SVG at `path`, written beside it and renamed. Errors: not_found without gnuplot, io_error, deadline_exceeded.
Status plot_history(const std::string& path, const std::vector<Curve>& curves);

}  // namespace rcb::cli
