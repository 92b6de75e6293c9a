#include "common/io/columns.hpp"

#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "common/base/wide.hpp"

namespace rcb::io {
namespace {

static_assert(std::endian::native == std::endian::little, "array files are read and written as little-endian memory");

std::string lower(std::string text) {
  for (char& c : text) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  }
  return text;
}

Result<std::size_t> find_weights(const std::string& file, const std::string& wanted, std::span<const std::string> names,
                                 std::size_t column_count) {
  for (const bool exact : {true, false}) {
    for (std::size_t c = 0; c < names.size(); ++c) {
      if (exact ? names[c] == wanted : lower(names[c]) == lower(wanted)) return c;
    }
  }
  std::size_t number = 0;
  const auto [end, error] = std::from_chars(wanted.data(), wanted.data() + wanted.size(), number);
  const bool is_number = error == std::errc{} && end == wanted.data() + wanted.size();
  if (is_number && number < column_count) return number;
  const auto some = names.subspan(0, std::min<std::size_t>(names.size(), 12));
  return Status(Code::invalid_argument, fmt::format("{}: no column '{}' for the weights", file, wanted),
                names.empty() ? fmt::format("the columns have no names here: give a number from 0 to {}",
                                            column_count == 0 ? 0 : column_count - 1)
                              : fmt::format("the columns are {}", fmt::join(some, ", ")));
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
  Columns columns;
  if (!options.weights.empty()) {
    const auto weights = find_weights(file, options.weights, names, column_count);
    if (!weights.ok()) return weights.status();
    columns.weight = *weights;
  }
  std::array<std::size_t, 4> named;
  named.fill(kNoColumn);
  for (std::size_t c = 0; c < names.size(); ++c) {
    const std::string name = lower(names[c]);
    const std::size_t which = name == "x" ? 0 : name == "y" ? 1 : name == "z" ? 2 : name == "id" ? 3 : 4;
    if (which == 4) continue;
    if (named[which] != kNoColumn) {
      return Status(Code::invalid_argument, fmt::format("{}: two columns are named '{}'", file, name), "rename one");
    }
    named[which] = c;
  }
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
