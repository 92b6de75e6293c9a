// Points as they are read. Which columns of a table are positions, id and weight; and the conversion of table rows into
// Points.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "common/base/status.hpp"
#include "common/base/wide.hpp"
#include "common/io/files/input_file.hpp"

namespace rcb::io {

class Roots;

struct ReadOptions {
  int dims = 0;  // 1..3; 0: columns named x, y, z, else all columns but those of weights and ids (more than 3:
                 // refused)
  std::string weights = {};               // a column's name, or its number from 0; empty: none
  std::vector<std::string> columns = {};  // likewise, those of the positions; empty: x, y, z, else the first ones
  std::string ids = {};                   // likewise; empty: the one named id
  // Set when files are read for a client: only files below these, and no message shows what a file holds. Null:
  // whatever this process may read.
  const Roots* below = nullptr;
  std::uint64_t bytes_max = 0;  // of all ranks' points together, or of a text file; 0: no limit
  // Set by another thread, or a signal handler, to end reading, with the error aborted; may be null.
  const std::atomic<bool>* stop = nullptr;
  // Called a few times a second while a FIFO or standard input gives nothing, with the seconds waited; may be empty.
  std::function<void(double)> on_wait = {};
};

struct Points {
  int dims = 0;
  std::size_t count = 0;
  std::vector<std::vector<double>> position;  // [dims][count]
  std::vector<std::int64_t> id;               // [count]; empty: ids by row
  std::vector<double> weight;                 // [count] or empty
  std::optional<std::int64_t> timestep;       // of the program that wrote the frame, where the file says it
  FileVersion file;                           // all slices of a set must be of one file in one state
};

constexpr std::size_t kNoColumn = static_cast<std::size_t>(-1);

struct Columns {
  int dims = 0;
  std::array<std::size_t, 3> axis{kNoColumn, kNoColumn, kNoColumn};
  std::size_t id = kNoColumn;
  std::size_t weight = kNoColumn;

  bool weighted() const { return weight != kNoColumn; }
};

// Errors: too_large, if `bytes` are more than the options allow.
Status check_bytes(const std::string& file, u128 bytes, const ReadOptions& options);
// Bytes of a particle in memory.
std::uint64_t point_bytes(const Columns& columns);

// names: what the file calls its columns, one each; empty: nothing. Columns that the options don't name are taken by
// name or, in a file without names, in order. Errors: names, but not those of axes. file, rows: for messages.
Result<Columns> choose_columns(const std::string& file, const ReadOptions& options, std::span<const std::string> names,
                               std::size_t column_count, std::optional<std::uint64_t> rows = {});

// Text of a file for a message, in quotation marks. If the file is read for somebody else (options.below), only the
// `kind` of text, such as "its text".
std::string quoted(std::string_view text, const char* kind, const ReadOptions& options);

// Points with dims and array lengths for `count` rows of these columns.
Points make_points(const Columns& columns, std::size_t count);

// A number's type in a file: float32, float64, or integers of 1 to 8 bytes, in either byte order.
struct NumberType {
  enum class Kind : std::uint8_t { real, integer, natural, unread };  // natural: without a sign; unread: any other type
  std::size_t bytes = 8;
  bool swapped = false;
  Kind kind = Kind::real;
};

// A column of rows whose columns have types of their own.
struct Field {
  std::size_t offset = 0;  // in the row
  NumberType type;
};

// A block of rows. Element (row, column) lies at first + row * row_stride + column * column_stride or, where there are
// fields, at first + row * row_stride + the field's offset.
struct RowBlock {
  const std::byte* first = nullptr;
  std::size_t row_stride = 0;
  std::size_t column_stride = 0;
  NumberType type;
  std::span<const Field> fields = {};
};

// A value that is refused.
struct BadValue {
  enum class Is : std::uint8_t { not_finite, negative, no_id };  // negative: a weight
  std::size_t row = 0;                                           // in the block
  std::size_t column = 0;
  double value = 0;
  Is is = Is::not_finite;
};
// place: such as "at index (3, 1)".
Status refusal_of(const BadValue& bad, const std::string& file, const std::string& place);

// Stores `count` rows as points [begin, begin + count). Returns the first bad value in row order, if any.
std::optional<BadValue> store_rows(const RowBlock& block, std::size_t count, const Columns& columns, std::size_t begin,
                                   Points& points);

// Two rows with the same id; of several such pairs, the one whose second row comes first.
std::optional<std::pair<std::size_t, std::size_t>> find_duplicate(const std::vector<std::int64_t>& ids);

// Share k of `of` has the rows [share_begin(k), share_begin(k + 1)).
std::uint64_t share_begin(std::uint64_t count, int k, int of);

}  // namespace rcb::io
