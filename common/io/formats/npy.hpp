// NumPy's array files, versions 1 to 3. Source: numpy.lib.format, "NPY format", numpy.org/neps/nep-0001.
//
// Invariants
// 1. Nothing is allocated for the header's shape before it is checked against the file's length.
// 2. A row is the last axis; an array of three axes (steps, n, dims) is read as steps * n rows. A structured array's
//    element is a row.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/base/status.hpp"
#include "common/io/files/input_file.hpp"
#include "common/io/formats/columns.hpp"

namespace rcb::io {

constexpr std::string_view kNpyMagic = "\x93NUMPY";

// A structured array, whose elements have named fields, counts as one with a further axis of columns.
struct NpyHeader {
  NumberType type;
  std::size_t item_bytes = 8;  // of a number or, of a structured array, of an element
  bool fortran_order = false;
  std::vector<std::uint64_t> shape;  // 1 to 3 axes
  std::uint64_t data_begin = 0;
  std::vector<Field> fields;       // of a structured array, else empty
  std::vector<std::string> names;  // theirs; NAME:0, NAME:1 ... where a field holds several numbers
};

Result<NpyHeader> read_npy_header(const InputFile& file, const ReadOptions& options);

// The rows of an array of positions, whatever its order.
class NpyRows {
 public:
  // A Fortran-ordered array of three axes is converted to C order in memory here (as large as the file, twice that for
  // float32); all others stay in the file.
  static Result<NpyRows> open(InputFile file, const NpyHeader& header, const ReadOptions& options);

  const InputFile& file() const { return file_; }
  const Columns& columns() const { return columns_; }
  std::uint64_t rows() const { return rows_; }
  // Reads rows [begin, begin + count) into points; a bad value is an error that names the first one's index.
  Status read(std::uint64_t begin, std::size_t count, Points& points) const;
  // Reads all rows to check them, and keeps nothing.
  Status check() const;

 private:
  NpyRows(InputFile file, const NpyHeader& header) : file_(std::move(file)), header_(header) {}
  Status read_into(std::uint64_t begin, std::size_t count, std::size_t to, Buffer<std::byte>& scratch,
                   Points& points) const;
  Status turn_into_c_order();
  Status refuse(std::uint64_t row, const BadValue& bad) const;
  std::size_t row_bytes() const { return header_.fields.empty() ? width_ * header_.item_bytes : header_.item_bytes; }

  InputFile file_;
  NpyHeader header_;
  bool names_shown_ = true;  // in messages
  Columns columns_;
  std::uint64_t rows_ = 0;
  std::size_t width_ = 1;      // numbers per row
  Buffer<double> in_c_order_;  // only after turn_into_c_order
};

}  // namespace rcb::io
