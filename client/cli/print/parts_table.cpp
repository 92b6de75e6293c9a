#include "client/cli/print/parts_table.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>

#include <fmt/format.h>

namespace rcb::cli {
namespace {

constexpr std::size_t kPartsShownMax = 32;  // fit on a terminal at once
constexpr std::size_t kWorst = 5;

}  // namespace

bool summarised(std::size_t parts, bool all) { return !all && parts > kPartsShownMax; }

std::array<double, 3> least_median_largest(std::vector<double> values) {
  std::erase_if(values, [](double value) { return std::isnan(value); });
  if (values.empty()) return {std::nan(""), std::nan(""), std::nan("")};
  std::sort(values.begin(), values.end());
  const std::size_t half = values.size() / 2;
  const double median = values.size() % 2 == 1 ? values[half] : values[half - 1] / 2 + values[half] / 2;
  return {values.front(), median, values.back()};
}

void PartsTable::add(std::string title, std::vector<double> values, std::function<std::string(double)> text) {
  if (values.size() != parts_) throw std::out_of_range("its lists of parts differ in length");
  columns_.push_back({std::move(title), std::move(values), std::move(text)});
}

std::vector<std::string> PartsTable::cells(const std::string& title, const std::vector<double>& values) const {
  std::vector<std::string> list{title};
  for (std::size_t c = 0; c < columns_.size(); ++c)
    list.push_back(std::isnan(values[c]) ? "-" : columns_[c].text(values[c]));
  return list;
}

std::vector<std::string> PartsTable::part_cells(std::size_t part) const {
  std::vector<double> values;
  for (const Column& column : columns_) values.push_back(column.values[part]);
  return cells(std::to_string(part), values);
}

void PartsTable::print(const std::vector<double>& badness, bool all) const {
  const bool few = !summarised(parts_, all);
  std::vector<Table::Column> titles{{"part", few ? Table::Align::right : Table::Align::left}};
  for (const Column& column : columns_) titles.push_back({column.title});
  Table table(std::move(titles));
  if (few) {
    for (std::size_t p = 0; p < parts_; ++p) table.row(part_cells(p));
    table.print();
    return;
  }
  std::array<std::vector<double>, 3> summary;
  for (const Column& column : columns_) {
    const auto values = least_median_largest(column.values);
    for (std::size_t k = 0; k < summary.size(); ++k) summary[k].push_back(values[k]);
  }
  constexpr std::array<const char*, 3> kTitles{"least", "median", "largest"};
  for (std::size_t k = 0; k < summary.size(); ++k) table.row(cells(kTitles[k], summary[k]));
  std::vector<std::size_t> worst(parts_);
  std::iota(worst.begin(), worst.end(), std::size_t{0});
  std::partial_sort(worst.begin(), worst.begin() + kWorst, worst.end(), [&](std::size_t a, std::size_t b) {
    return badness[a] != badness[b] ? badness[a] > badness[b] : a < b;
  });
  for (std::size_t k = 0; k < kWorst; ++k) table.row(part_cells(worst[k]));
  table.print();
  print_line(fmt::format("of {} parts the worst {}; --all shows every one", parts_, kWorst));
}

}  // namespace rcb::cli
