// The options of halo, neighbours and box: a distance from regions, and which borders are periodic.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "client/cli/app.hpp"

namespace rcb::cli {

struct NearOptions {
  std::string name;
  double width = 0;
  std::string norm = "max";
  std::vector<std::string> periodic;  // LO... HI..., "-" for both where an axis isn't periodic; empty: none is
  bool all = false;
  double deadline_seconds = kQuestionSeconds;
};

// Adds --periodic.
void add_periodic(CLI::App& command, std::vector<std::string>& bounds);
// Adds NAME and all of the options.
void add_near_options(CLI::App& command, NearOptions& options);

// {"lo","hi"}, or null. Errors: usage.
Result<Json> periodic_json(const std::vector<std::string>& bounds);
// The arguments "scene", "width", "norm" and "periodic" of a command. Errors: usage.
Result<Json> near_json(const NearOptions& options);
// "width 0.1 (max), periodic 0 0 - to 1 1 -"
std::string near_text(const Json& arguments);

// "x", for 0.
std::string axis_name(const Json& axis);
// "narrowest region: part 3, 0.125 along x", from the reply to cuts or quality.
std::string narrowest_text(const Json& reply);

}  // namespace rcb::cli
