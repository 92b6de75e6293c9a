// What there is a number a part of. A table of many parts is summed up, unless all are asked for: the least, the median
// and the largest of each column, and the worst parts.
#pragma once

#include <array>
#include <cstddef>
#include <functional>
#include <string>
#include <vector>

#include "client/cli/output.hpp"

namespace rcb::cli {

// Whether so many parts are summed up.
bool summed_up(std::size_t parts, bool all);

// Of numbers that may be NaN, which don't count; NaN where there is none.
std::array<double, 3> least_median_largest(std::vector<double> values);

class PartsTable {
 public:
  explicit PartsTable(std::size_t parts) : parts_(parts) {}
  // values: one a part; NaN is shown as "-".
  void add(std::string title, std::vector<double> values, std::function<std::string(double)> text = number);
  // badness: larger is worse.
  void print(const std::vector<double>& badness, bool all) const;

 private:
  struct Column {
    std::string title;
    std::vector<double> values;
    std::function<std::string(double)> text;
  };

  std::vector<std::string> cells(const std::string& title, const std::vector<double>& values) const;
  std::vector<std::string> part_cells(std::size_t part) const;

  std::size_t parts_;
  std::vector<Column> columns_;
};

}  // namespace rcb::cli
