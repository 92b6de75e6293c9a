// What the command lines of rcb_bench and rcb_stress share: limits, what is checked of options, and how a program ends.
#pragma once

#include <cmath>
#include <functional>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "common/base/status.hpp"

namespace rcb::bench {

inline constexpr int kPartsMax = 1 << 20;
inline constexpr int kRanksMax = 256;
inline constexpr int kRepeatsMax = 1000;

// Remembers the first option that is wrong.
class OptionCheck {
 public:
  // command: whose --help says what is right.
  explicit OptionCheck(const std::string& command) : hint_(command + " --help") {}

  void holds(bool right, const std::string& message) {
    if (status_.ok() && !right) status_ = {Code::usage, message, hint_};
  }
  template <typename T>
  void between(const char* option, const std::vector<T>& values, double least, double most) {
    for (const T value : values)
      holds(value >= least && value <= most, fmt::format("{} {}: give {} to {}", option, value, least, most));
  }
  void whole(const char* option, const std::vector<double>& values, double least, double most) {
    for (const double value : values)
      holds(value >= least && value <= most && value == std::floor(value),
            fmt::format("{} {}: give whole numbers from {} to {}", option, value, least, most));
  }
  template <typename Known>
  void known(const char* option, const std::vector<std::string>& names, const Known& is_known) {
    for (const std::string& name : names)
      holds(is_known(name), fmt::format("{} {}: there is none of that name", option, name));
  }
  const Status& status() const { return status_; }

 private:
  std::string hint_;
  Status status_;
};

// An option that takes several values.
template <typename T>
void add_list(CLI::App& command, const char* name, std::vector<T>& values, const std::string& text) {
  command.add_option(name, values, text)->delimiter(',')->capture_default_str();
}

// Parses, then runs, and says what was wrong. Returns the exit code.
int run_program(CLI::App& app, int argc, char** argv, const std::function<Status()>& run);

}  // namespace rcb::bench
