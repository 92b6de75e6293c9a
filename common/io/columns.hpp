// Which columns of a table are positions, id and weight; and the store of table rows into Points.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.hpp"
#include "common/io/points.hpp"

namespace rcb::io {

constexpr std::size_t kNoColumn = static_cast<std::size_t>(-1);

struct Columns {
  int dims = 0;
  std::array<std::size_t, 3> axis{kNoColumn, kNoColumn, kNoColumn};
  std::size_t id = kNoColumn;
  std::size_t weight = kNoColumn;

  bool weighted() const { return weight != kNoColumn; }
};

// names: of a header, one a column; empty: the table has none. By name where x, y or z is named, else the first
// columns beside id and weight. file: for messages.
Result<Columns> choose_columns(const std::string& file, const ReadOptions& options, std::span<const std::string> names,
                               std::size_t column_count);

// Text of a file made fit for a message, in quotation marks; of a file that is read on somebody else's word the `kind`
// of text alone, such as "its text".
std::string quoted(std::string_view text, const char* kind, const ReadOptions& options);

// dims and array lengths for `count` points of these columns.
Points make_points(const Columns& columns, std::size_t count);

// float32 or float64 in a file's byte order.
struct NumberType {
  std::size_t bytes = 8;
  bool swapped = false;
};

// Where a block of rows has its element (row, column): first + row * row_stride + column * column_stride.
struct RowBlock {
  const std::byte* first = nullptr;
  std::size_t row_stride = 0;
  std::size_t column_stride = 0;
  NumberType type;
};

// A value that is refused: NaN, infinity or a negative weight.
struct BadValue {
  std::size_t row = 0;  // in the block
  std::size_t column = 0;
  double value = 0;
};
std::string describe(double bad_value);

// Turns `count` rows into points [begin, begin + count). Returns the first bad value in row order, if any.
std::optional<BadValue> store_rows(const RowBlock& block, std::size_t count, const Columns& columns, std::size_t begin,
                                   Points& points);

// The rows of share k of `of`: [share_begin(k), share_begin(k + 1)).
std::uint64_t share_begin(std::uint64_t count, int k, int of);

}  // namespace rcb::io
