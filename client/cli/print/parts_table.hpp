// Tables with a row for each part. Many parts are summarised, unless all are asked for: minimum, median and maximum of
// each column, and the worst parts.
#pragma once

#include <array>
#include <cstddef>
#include <functional>
#include <string>
#include <vector>

#include "client/cli/print/output.hpp"

namespace rcb::cli {

// Whether a table of so many parts is summarised.
bool summarised(std::size_t parts, bool all);

// NaN values don't count; NaN if there is no other value.
std::array<double, 3> least_median_largest(std::vector<double> values);

class PartsTable {
 public:
  explicit PartsTable(std::size_t parts) : parts_(parts) {}
  // values: one for each part; NaN is shown as "-". Throws std::out_of_range where a service sent more or fewer.
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
