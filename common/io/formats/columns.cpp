#include "common/io/formats/columns.hpp"

#include <algorithm>
#include <charconv>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "common/base/wide.hpp"
#include "common/io/files/input_file.hpp"
#include "common/io/formats/fields.hpp"

namespace rcb::io {
namespace {

constexpr std::size_t kColumnsMax = 4096;     // whole rows are read, and points have few columns
constexpr std::size_t kLyingColumnsMin = 16;  // more columns than that in at most 3 rows: (dims, n)
constexpr std::size_t kPointColumnsMax = 64;  // likewise in any number of rows, perhaps
constexpr const char* kTransposeHint = "a point is a row: if the array is (dims, n), transpose it";
constexpr const char* kColumnsHint = "say with --columns which are the positions, by name or by number, counted from 0";

// What x, y and z may be called: plainly, or as ParaView names coordinates in a CSV file.
constexpr std::array<std::array<std::string_view, 3>, 3> kAxisNames{
    {{"x", "y", "z"}, {"points:0", "points:1", "points:2"}, {"points_0", "points_1", "points_2"}}};

// The columns that a file has.
struct Table {
  const std::string& file;
  const ReadOptions& options;
  std::span<const std::string> names;
  std::size_t count;
};

Status check_options(const std::string& file, const ReadOptions& options) {
  if (options.dims < 0 || options.dims > 3)
    return {Code::invalid_argument, fmt::format("{} dimensions", options.dims), "give 1, 2 or 3 (--dims)"};
  const std::size_t axes = options.columns.size();
  if (axes > 3)
    return {Code::invalid_argument, fmt::format("{}: {} columns of positions are asked for", file, axes),
            "give 1, 2 or 3 (--columns)"};
  if (axes > 0 && options.dims > 0 && axes != static_cast<std::size_t>(options.dims))
    return {Code::invalid_argument,
            fmt::format("{}: {} columns of positions are asked for in {} dimension(s)", file, axes, options.dims),
            "give as many --columns as --dims, or leave --dims out"};
  std::vector<std::string_view> columns(options.columns.begin(), options.columns.end());
  columns.insert(columns.end(), {options.weights, options.ids});
  for (const std::string_view column : columns)
    if (column.find('\0') != std::string_view::npos)
      return {Code::invalid_argument, file + ": a column's name holds a NUL byte"};
  return {};
}

// The columns by name, those without one by number.
std::string listed(const Table& table) {
  std::vector<std::string> some;
  for (std::size_t c = 0; c < std::min<std::size_t>(table.names.size(), 12); ++c)
    some.push_back(table.names[c].empty() ? std::to_string(c) : shown(table.names[c]));
  return fmt::format("{}{}", fmt::join(some, ", "), some.size() < table.names.size() ? ", ..." : "");
}

// The column with this name, given in lower case; kNoColumn if there is none. Errors: two columns of that name.
Result<std::size_t> find_named(const Table& table, std::string_view wanted) {
  std::size_t found = kNoColumn;
  for (std::size_t c = 0; c < table.names.size(); ++c) {
    if (plain_name(table.names[c]) != wanted) continue;
    if (found != kNoColumn)
      return Status(Code::invalid_argument, fmt::format("{}: two columns are named '{}'", table.file, wanted),
                    "rename one, or say with --columns (--ids for the ids) which to take, by number, counted from 0");
    found = c;
  }
  return found;
}

// The column that an option asks for; purpose: what it holds.
Result<std::size_t> find_asked(const Table& table, const std::string& wanted, const char* purpose) {
  for (const bool exact : {true, false}) {
    std::vector<std::size_t> found;
    for (std::size_t c = 0; c < table.names.size(); ++c)
      if (exact ? table.names[c] == wanted : lowered(table.names[c]) == lowered(wanted)) found.push_back(c);
    if (found.size() == 1) return found[0];
    if (found.size() > 1)
      return Status(Code::invalid_argument, fmt::format("{}: two columns are named '{}'", table.file, shown(wanted)),
                    fmt::format("give the number of one, counted from 0: {} or {}", found[0], found[1]));
  }
  std::size_t number = 0;
  const auto [end, error] = std::from_chars(wanted.data(), wanted.data() + wanted.size(), number);
  const bool is_number = error == std::errc{} && end == wanted.data() + wanted.size();
  if (is_number && number < table.count) return number;
  std::string hint = fmt::format("give its name, or a number from 0 to {}", table.count == 0 ? 0 : table.count - 1);
  if (table.options.below == nullptr)
    hint = table.names.empty() ? "the columns have no names here: " + hint : "the columns are " + listed(table);
  return Status(Code::invalid_argument,
                fmt::format("{}: no column '{}' for the {}", table.file, shown(wanted), purpose), hint);
}

Result<std::size_t> id_column(const Table& table) {
  return table.options.ids.empty() ? find_named(table, "id") : find_asked(table, table.options.ids, "ids");
}

// The columns with the names of axes.
Result<std::vector<std::size_t>> named_axes(const Table& table, const Columns& columns) {
  std::vector<std::size_t> found;
  for (auto names = kAxisNames.begin(); names != kAxisNames.end() && found.empty(); ++names) {
    for (const std::string_view name : *names) {
      const auto column = find_named(table, name);
      if (!column.ok()) return column.status();
      if (*column != kNoColumn) found.push_back(*column);
    }
  }
  // Beside a lone z others may be the first axes, as in r,z.
  const std::size_t others = table.count - (columns.id != kNoColumn ? 1U : 0U) -
                             (columns.weighted() && columns.weight != columns.id ? 1U : 0U);
  const bool first = !found.empty() && std::any_of(kAxisNames.begin(), kAxisNames.end(), [&](const auto& names) {
    return plain_name(table.names[found[0]]) == names[0];
  });
  if (first || found.size() > 1 || (found.size() == 1 && others <= 1)) return found;
  return Status(Code::invalid_argument,
                table.options.below == nullptr
                    ? fmt::format("{}: its columns are named {}, not x, y and z", table.file, listed(table))
                    : table.file + ": its columns are not named x, y and z",
                kColumnsHint);
}

// Where there are no names: the first columns that are neither ids nor weights.
Result<std::vector<std::size_t>> first_axes(const Table& table, const Columns& columns,
                                            std::optional<std::uint64_t> rows) {
  std::vector<std::size_t> axes;
  for (std::size_t c = 0; c < table.count; ++c)
    if (c != columns.id && c != columns.weight) axes.push_back(c);
  if (axes.empty())
    return Status(Code::invalid_argument, table.file + ": has no column of positions", "name columns x, y, z");
  // An array (dims, n) lies on its side: --dims would make three points of it.
  const bool few_rows = rows && *rows > 0 && *rows <= 3;
  const bool lies = few_rows && axes.size() > kLyingColumnsMin;
  if (table.options.dims != 0 ? !lies : axes.size() <= 3) return axes;
  std::string hint =
      "say which are: --columns 0,1,2 (their numbers, counted from 0; or --dims 3 for the first 3), or name the "
      "columns "
      "x, y, z in a header";
  if (few_rows) hint += fmt::format("; {}", kTransposeHint);
  if (lies || axes.size() > kPointColumnsMax) hint = kTransposeHint;
  return Status(Code::invalid_argument, fmt::format("{}: {} columns could be positions", table.file, axes.size()),
                hint);
}

Result<std::vector<std::size_t>> asked_axes(const Table& table) {
  std::vector<std::size_t> axes;
  for (const std::string& wanted : table.options.columns) {
    const auto column = find_asked(table, wanted, "positions");
    if (!column.ok()) return column.status();
    if (std::find(axes.begin(), axes.end(), *column) != axes.end())
      return Status(Code::invalid_argument,
                    fmt::format("{}: column '{}' is asked for twice", table.file, shown(wanted)),
                    "give every axis a column of its own (--columns)");
    axes.push_back(*column);
  }
  return axes;
}

}  // namespace

Result<Columns> choose_columns(const std::string& file, const ReadOptions& options, std::span<const std::string> names,
                               std::size_t column_count, std::optional<std::uint64_t> rows) {
  if (Status good = check_options(file, options); !good.ok()) return good;
  if (column_count > kColumnsMax)
    return Status(Code::too_large,
                  fmt::format("{}: has {} columns; at most {} are read", file, column_count, kColumnsMax),
                  kTransposeHint);
  const Table table{file, options, names, column_count};
  Columns columns;
  if (!options.weights.empty()) {
    const auto weights = find_asked(table, options.weights, "weights");
    if (!weights.ok()) return weights.status();
    columns.weight = *weights;
  }
  const auto id = id_column(table);
  if (!id.ok()) return id.status();
  columns.id = *id;
  const auto axes = !options.columns.empty() ? asked_axes(table)
                    : names.empty()          ? first_axes(table, columns, rows)
                                             : named_axes(table, columns);
  if (!axes.ok()) return axes.status();
  if (std::find(axes->begin(), axes->end(), columns.id) != axes->end())
    return Status(Code::invalid_argument, file + ": one column can't be both ids and positions",
                  "give others: --columns for the positions, --ids for the ids");
  columns.dims = options.dims != 0 ? options.dims : static_cast<int>(axes->size());
  const auto dims = static_cast<std::size_t>(columns.dims);
  if (dims > axes->size())
    return Status(Code::invalid_argument,
                  fmt::format("{}: has {} column{} of positions, {} are asked for", file, axes->size(),
                              axes->size() == 1 ? "" : "s", dims),
                  names.empty() ? "leave --dims out, or give a file with more columns" : kColumnsHint);
  std::copy_n(axes->begin(), dims, columns.axis.begin());
  return columns;
}

std::string quoted(std::string_view text, const char* kind, const ReadOptions& options) {
  return options.below == nullptr ? "'" + shown(text) + "'" : kind;
}

Status check_bytes(const std::string& file, u128 bytes, const ReadOptions& options) {
  if (options.bytes_max == 0 || bytes <= options.bytes_max) return {};
  return {Code::too_large,
          fmt::format("{}: needs {:.4g} bytes of memory, at most {} are taken", file, static_cast<double>(bytes),
                      options.bytes_max),
          "start the service with a larger --bulk-bytes, or on a larger machine"};
}

std::uint64_t point_bytes(const Columns& columns) {
  return 8 * (static_cast<std::uint64_t>(columns.dims) + (columns.id != kNoColumn ? 1U : 0U) +
              (columns.weighted() ? 1U : 0U));
}

Points make_points(const Columns& columns, std::size_t count) {
  Points points;
  points.dims = columns.dims;
  points.count = count;
  points.position.resize(static_cast<std::size_t>(columns.dims));
  for (auto& axis : points.position) axis.resize(count);
  if (columns.id != kNoColumn) points.id.resize(count);
  if (columns.weighted()) points.weight.resize(count);
  return points;
}

std::optional<std::pair<std::size_t, std::size_t>> find_duplicate(const std::vector<std::int64_t>& ids) {
  bool ascending = true;
  for (std::size_t i = 1; i < ids.size() && ascending; ++i) ascending = ids[i - 1] < ids[i];
  if (ascending) return std::nullopt;
  std::vector<std::pair<std::int64_t, std::size_t>> sorted(ids.size());
  for (std::size_t i = 0; i < ids.size(); ++i) sorted[i] = {ids[i], i};
  std::sort(sorted.begin(), sorted.end());
  std::optional<std::pair<std::size_t, std::size_t>> found;
  for (std::size_t i = 1; i < sorted.size(); ++i) {
    if (sorted[i - 1].first != sorted[i].first) continue;
    if (!found || sorted[i].second < found->second) found = {sorted[i - 1].second, sorted[i].second};
  }
  return found;
}

std::uint64_t share_begin(std::uint64_t count, int k, int of) {
  return static_cast<std::uint64_t>(static_cast<u128>(count) * static_cast<unsigned>(k) / static_cast<unsigned>(of));
}

}  // namespace rcb::io
