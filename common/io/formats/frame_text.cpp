#include "common/io/formats/frame_text.hpp"

#include <algorithm>

#include <fmt/format.h>

#include "common/io/formats/fields.hpp"

namespace rcb::io {

Result<std::optional<Points>> FrameText::next() {
  // Blank lines may stand between frames and at the end.
  for (;;) {
    const auto line = lines_.peek(1);
    if (!line) return line.status();
    if (line->empty()) return std::optional<Points>();
    if (!trimmed(line->substr(0, line->find('\n'))).empty()) break;
    if (const auto blank = lines_.next(1, LastLine::may_lack_its_end); !blank) return blank.status();
  }
  begun_ = {.line = lines_.line(), .which = fmt::format("frame {}", number_)};
  rows_read_ = 0;
  auto points = read_frame();
  if (!points) return points;
  if (*points) {
    ++number_;
    return points;
  }
  const std::string rows =
      begun_.count ? fmt::format(", after {} of its {} rows", rows_read_, *begun_.count) : std::string();
  unfinished_ =
      fmt::format("{}: ends within {}, which begins in line {}{}", lines_.name(), begun_.which, begun_.line, rows);
  if (!lines_.source().is_stream) return points;
  return Status(Code::invalid_argument, unfinished_, "did the program that writes it fail?");
}

Result<std::optional<std::string>> FrameText::next_line(LastLine last) {
  const auto line = lines_.next(1, last);
  if (!line) return line.status();
  if (line->empty()) return std::optional<std::string>();
  return std::optional(std::string(trimmed(line->substr(0, line->find('\n')))));
}

Status FrameText::fault(std::uint64_t line, const std::string& what, const std::string& hint) const {
  return {Code::invalid_argument, fmt::format("{}:{}: {}: {}", lines_.name(), line, begun_.which, what), hint};
}

Status FrameText::row_refused(std::uint64_t line, std::string_view row, const TextLayout& layout,
                              std::uint64_t rows) const {
  if (row.starts_with("ITEM:"))
    return fault(line, fmt::format("has {} rows, {} are announced", rows, *begun_.count),
                 "was the program that wrote it stopped here, and run again into the same file?");
  const std::size_t columns = split_fields(row, layout.separator).size();
  if (columns != layout.column_count)
    return fault(line,
                 fmt::format("row {} has {} column{}, but {} {}", rows + 1, columns, columns == 1 ? "" : "s",
                             columns_from(), layout.column_count),
                 fmt::format("does the frame have the {} rows that it announces?", *begun_.count));
  return row_fault(lines_.name(), line, row, layout, options_);
}

Status FrameText::check_ids(const Points& points) const {
  const auto twice = find_duplicate(points.id);
  if (!twice) return {};
  return fault(
      begun_.line,
      fmt::format("id {} stands in its rows {} and {}", points.id[twice->first], twice->first + 1, twice->second + 1),
      "give every particle an id of its own");
}

Result<std::optional<Points>> FrameText::read_rows(const TextLayout& layout, std::uint64_t count, LastLine last) {
  Points points = make_points(layout.columns, 0);
  begun_.count = count;
  while (points.count < count) {
    const std::uint64_t first = lines_.line();
    const auto block = lines_.next(count - points.count, last);
    if (!block) return block.status();
    if (block->empty()) return std::optional<Points>();
    if (const auto refused = parse_rows(*block, layout, points)) {
      const auto before = std::count(block->data(), refused->data(), '\n');
      return row_refused(first + static_cast<std::uint64_t>(before), *refused, layout, points.count);
    }
    rows_read_ = points.count;
  }
  if (Status ids = check_ids(points); !ids) return ids;
  return std::optional(std::move(points));
}

}  // namespace rcb::io
