#include "common/io/formats/columns.hpp"

#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "common/base/wide.hpp"
#include "common/io/files/input_file.hpp"

namespace rcb::io {
namespace {

static_assert(std::endian::native == std::endian::little, "array files are read and written as little-endian memory");

std::string lower(std::string text) {
  for (char& c : text) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  }
  return text;
}

// The columns of x, y, z and id.
using Named = std::array<std::size_t, 4>;

// The columns with these four names, given in lower case. Errors: two columns of one name.
Result<Named> find_named(const std::string& file, std::span<const std::string> names,
                         const std::array<std::string_view, 4>& wanted) {
  Named named;
  named.fill(kNoColumn);
  for (std::size_t c = 0; c < names.size(); ++c) {
    const std::string name = lower(names[c]);
    const auto found = std::find(wanted.begin(), wanted.end(), name);
    if (found == wanted.end()) continue;
    std::size_t& column = named[static_cast<std::size_t>(found - wanted.begin())];
    if (column != kNoColumn)
      return Status(Code::invalid_argument, fmt::format("{}: two columns are named '{}'", file, name), "rename one");
    column = c;
  }
  return named;
}

bool has_position(const Named& named) {
  return std::any_of(named.begin(), named.begin() + 3, [](std::size_t column) { return column != kNoColumn; });
}

// By the plain names or, failing these, by those that ParaView gives coordinates in a CSV file.
Result<Named> find_named(const std::string& file, std::span<const std::string> names) {
  auto named = find_named(file, names, {"x", "y", "z", "id"});
  for (const std::array<std::string_view, 4>& paraview :
       {std::array<std::string_view, 4>{"points:0", "points:1", "points:2", "id"},
        std::array<std::string_view, 4>{"points_0", "points_1", "points_2", "id"}})
    if (named.ok() && !has_position(*named)) named = find_named(file, names, paraview);
  return named;
}

Result<std::size_t> find_weights(const std::string& file, const ReadOptions& options,
                                 std::span<const std::string> names, std::size_t column_count) {
  const std::string& wanted = options.weights;
  for (const bool exact : {true, false}) {
    for (std::size_t c = 0; c < names.size(); ++c) {
      if (exact ? names[c] == wanted : lower(names[c]) == lower(wanted)) return c;
    }
  }
  std::size_t number = 0;
  const auto [end, error] = std::from_chars(wanted.data(), wanted.data() + wanted.size(), number);
  const bool is_number = error == std::errc{} && end == wanted.data() + wanted.size();
  if (is_number && number < column_count) return number;
  std::string hint = fmt::format("give its name, or a number from 0 to {}", column_count == 0 ? 0 : column_count - 1);
  if (options.below == nullptr && names.empty()) hint = "the columns have no names here: " + hint;
  if (options.below == nullptr && !names.empty()) {
    std::vector<std::string> some;
    for (const std::string& name : names.first(std::min<std::size_t>(names.size(), 12))) some.push_back(shown(name));
    hint = fmt::format("the columns are {}", fmt::join(some, ", "));
  }
  return Status(Code::invalid_argument, fmt::format("{}: no column '{}' for the weights", file, shown(wanted)), hint);
}

template <std::size_t kBytes, bool kSwapped>
bool convert(const std::byte* from, std::size_t stride, std::size_t count, double* to) {
  using Number = std::conditional_t<kBytes == 4, float, double>;
  using Bits = std::conditional_t<kBytes == 4, std::uint32_t, std::uint64_t>;
  bool finite = true;
  for (std::size_t i = 0; i < count; ++i) {
    Bits bits;
    std::memcpy(&bits, from + i * stride, kBytes);
    if constexpr (kSwapped && kBytes == 4) bits = __builtin_bswap32(bits);
    if constexpr (kSwapped && kBytes == 8) bits = __builtin_bswap64(bits);
    const double value = static_cast<double>(std::bit_cast<Number>(bits));
    to[i] = value;
    finite &= std::fabs(value) <= std::numeric_limits<double>::max();
  }
  return finite;
}

bool convert(const RowBlock& block, std::size_t column, std::size_t count, double* to) {
  const std::byte* from = block.first + column * block.column_stride;
  if (block.type.bytes == 4) {
    return block.type.swapped ? convert<4, true>(from, block.row_stride, count, to)
                              : convert<4, false>(from, block.row_stride, count, to);
  }
  return block.type.swapped ? convert<8, true>(from, block.row_stride, count, to)
                            : convert<8, false>(from, block.row_stride, count, to);
}

}  // namespace

Result<Columns> choose_columns(const std::string& file, const ReadOptions& options, std::span<const std::string> names,
                               std::size_t column_count) {
  if (options.dims < 0 || options.dims > 3) {
    return Status(Code::invalid_argument, fmt::format("{} dimensions", options.dims), "give 1, 2 or 3 (--dims)");
  }
  constexpr std::size_t kColumnsMax = 4096;  // whole rows are read, and points have few columns
  if (column_count > kColumnsMax)
    return Status(Code::too_large,
                  fmt::format("{}: has {} columns; at most {} are read", file, column_count, kColumnsMax),
                  "a point is a row: if the array is (dims, n), transpose it");
  if (options.weights.find('\0') != std::string::npos)
    return Status(Code::invalid_argument, file + ": the weights' name holds a NUL byte");
  Columns columns;
  if (!options.weights.empty()) {
    const auto weights = find_weights(file, options, names, column_count);
    if (!weights.ok()) return weights.status();
    columns.weight = *weights;
  }
  const auto found = find_named(file, names);
  if (!found.ok()) return found.status();
  const Named& named = *found;
  columns.id = named[3];
  std::vector<std::size_t> candidates;
  for (std::size_t a = 0; a < 3; ++a) {
    if (named[a] != kNoColumn) candidates.push_back(named[a]);
  }
  const bool by_name = !candidates.empty();
  for (std::size_t c = 0; c < column_count && !by_name; ++c) {
    if (c != columns.id && c != columns.weight) candidates.push_back(c);
  }
  if (candidates.empty()) {
    return Status(Code::invalid_argument, file + ": has no column of positions", "name columns x, y, z");
  }
  if (options.dims == 0 && candidates.size() > 3) {
    return Status(Code::invalid_argument, fmt::format("{}: {} columns could be positions", file, candidates.size()),
                  "say with --dims how many of the first are, or name the columns x, y, z in a header");
  }
  columns.dims = options.dims != 0 ? options.dims : static_cast<int>(candidates.size());
  const auto dims = static_cast<std::size_t>(columns.dims);
  if (dims > candidates.size()) {
    return Status(Code::invalid_argument,
                  fmt::format("{}: has {} column{} of positions, {} are asked for", file, candidates.size(),
                              candidates.size() == 1 ? "" : "s", dims),
                  "leave --dims out, or give a file with more columns");
  }
  std::copy_n(candidates.begin(), dims, columns.axis.begin());
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

std::string describe(double bad_value) {
  if (std::isnan(bad_value)) return "NaN";
  if (std::isinf(bad_value)) return bad_value > 0 ? "infinity" : "-infinity";
  return fmt::format("the weight {}, which is negative,", bad_value);
}

std::optional<BadValue> store_rows(const RowBlock& block, std::size_t count, const Columns& columns, std::size_t begin,
                                   Points& points) {
  std::optional<BadValue> bad;
  const auto store = [&](std::size_t column, double* to, bool weight) {
    bool good = convert(block, column, count, to);
    if (good && weight) good = std::none_of(to, to + count, [](double w) { return w < 0; });
    if (good) return;
    const double* first =
        std::find_if(to, to + count, [&](double v) { return !std::isfinite(v) || (weight && v < 0); });
    const BadValue found{static_cast<std::size_t>(first - to), column, *first};
    if (!bad || found.row < bad->row || (found.row == bad->row && found.column < bad->column)) bad = found;
  };
  for (std::size_t a = 0; a < static_cast<std::size_t>(columns.dims); ++a) {
    store(columns.axis[a], points.position[a].data() + begin, false);
  }
  if (columns.weighted()) store(columns.weight, points.weight.data() + begin, true);
  return bad;
}

std::uint64_t share_begin(std::uint64_t count, int k, int of) {
  return static_cast<std::uint64_t>(static_cast<u128>(count) * static_cast<unsigned>(k) / static_cast<unsigned>(of));
}

}  // namespace rcb::io
