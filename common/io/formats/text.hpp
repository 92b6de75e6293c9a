// Text files of points: CSV and the like, and XYZ. In three steps: the layout (what the first lines say), the rows (the
// fast loop), the faults (what is wrong in a line that the loop refused).
//
// Invariants
// 1. A row is a line that is neither blank nor a comment; every row has as many fields as the first line. A comment
//    begins with #; behind the first row or header a blank must follow, so that a row whose first field is #N/A counts.
// 2. Share k of K has the rows whose lines begin in its range of bytes, so K shares together have every row once.
// 3. A fault names the line of the whole file; lines are counted only then.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "common/base/status.hpp"
#include "common/io/files/input_file.hpp"
#include "common/io/formats/columns.hpp"

namespace rcb::io {

struct TextLayout {
  std::size_t data_begin = 0;  // the byte of the file at which rows may begin
  char separator = ' ';
  std::size_t column_count = 0;
  std::vector<std::string> names;  // of a header or a comment; empty without these
  Columns columns;
  std::optional<std::uint64_t> row_count;  // as an XYZ file's first line claims
  bool comment_is_row = false;             // of an XYZ file: whether its second line could be a row, too
};

// head: the beginning of the file; whole: true if that is all of it. nullopt if more of the file is needed to decide.
// Errors: as choose_columns, and a first row that is neither header nor numbers.
std::optional<Result<TextLayout>> text_layout(const std::string& file, std::string_view head, bool whole,
                                              const ReadOptions& options);

// The next row at or after `at` (which is moved behind it): the line without surrounding blanks. nullopt at the end.
std::optional<std::string_view> next_row(std::string_view text, std::size_t& at);

// Appends the rows of `text` to points. Returns the first row that is refused, if any.
std::optional<std::string_view> parse_rows(std::string_view text, const TextLayout& layout, Points& points);

// Why parse_rows refused that row; line: its number in the file.
Status row_fault(const std::string& file, std::uint64_t line, std::string_view row, const TextLayout& layout,
                 const ReadOptions& options);

Result<TextLayout> text_layout_of(const InputFile& file, const ReadOptions& options);
// Calls visit(fields) for each row of the file, with all its fields, in the file's order.
Status visit_fields(const InputFile& file, const TextLayout& layout,
                    const std::function<void(const std::vector<std::string_view>&)>& visit);

Result<Points> read_text(const InputFile& file, const ReadOptions& options, int k, int of);

}  // namespace rcb::io
