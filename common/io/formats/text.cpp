#include "common/io/formats/text.hpp"

#include <algorithm>
#include <array>
#include <cstring>
#include <utility>

#include <fmt/format.h>

#include "common/base/buffer.hpp"
#include "common/io/formats/fields.hpp"

namespace rcb::io {
namespace {

constexpr std::size_t kTextHeadBytes = std::size_t{64} << 10U;

// A range of the file, in memory.
struct Window {
  Buffer<char> bytes;
  std::uint64_t begin = 0;

  std::string_view text() const { return {bytes.data(), bytes.size()}; }
};

Status load(const InputFile& file, std::uint64_t begin, std::uint64_t end, Window& window) {
  const auto size = static_cast<std::size_t>(end - begin);
  if (!window.bytes.try_reserve(size)) {
    return Status(Code::too_large, fmt::format("{}: no memory for {} bytes of it", file.path(), size));
  }
  window.begin = begin;
  window.bytes.resize(size);
  return file.read_at(begin, window.bytes.data(), size);
}

Result<std::uint64_t> line_at(const InputFile& file, std::uint64_t offset) {
  std::uint64_t line = 1;
  Window window;
  for (std::uint64_t at = 0; at < offset; at += window.bytes.size()) {
    if (const Status read = load(file, at, std::min<std::uint64_t>(offset, at + (1U << 20U)), window); !read.ok())
      return read;
    line += static_cast<std::uint64_t>(std::count(window.bytes.begin(), window.bytes.end(), '\n'));
  }
  return line;
}

// Loads the lines that begin in the share's range of the file's bytes.
Status load_share(const InputFile& file, std::uint64_t data_begin, int k, int of, Window& window) {
  const std::uint64_t length = file.size() - data_begin;
  std::uint64_t begin = data_begin + share_begin(length, k, of);
  const std::uint64_t end = data_begin + share_begin(length, k + 1, of);
  // Includes the byte before the range, which tells whether a line begins with the range.
  const std::uint64_t from = begin > data_begin ? begin - 1 : begin;
  if (const Status read = load(file, from, end, window); !read.ok()) return read;
  if (begin == end) {
    window.bytes.clear();
    return {};
  }
  // The last line may end behind the range.
  std::uint64_t behind = end;
  while (window.bytes[window.bytes.size() - 1] != '\n' && behind < file.size()) {
    const auto more = static_cast<std::size_t>(std::min<std::uint64_t>(file.size() - behind, kTextHeadBytes));
    const std::size_t old = window.bytes.size();
    if (!window.bytes.try_reserve(old + more)) {
      return Status(Code::too_large, file.path() + ": no memory for one of its lines");
    }
    window.bytes.resize(old + more);
    if (const Status read = file.read_at(behind, window.bytes.data() + old, more); !read.ok()) return read;
    const void* found = std::memchr(window.bytes.data() + old, '\n', more);
    behind += more;
    if (found != nullptr) {
      window.bytes.resize(static_cast<std::size_t>(static_cast<const char*>(found) - window.bytes.data()) + 1);
    }
  }
  if (begin > data_begin) {
    const auto first_end = std::find(window.bytes.begin(), window.bytes.end(), '\n');
    const auto dropped = static_cast<std::size_t>(first_end - window.bytes.begin()) + 1;
    // No line begins in this range if the one before it reaches beyond.
    if (first_end == window.bytes.end() || from + dropped >= end) {
      window.bytes.clear();
      return {};
    }
    std::memmove(window.bytes.data(), window.bytes.data() + dropped, window.bytes.size() - dropped);
    window.bytes.resize(window.bytes.size() - dropped);
    window.begin = from + dropped;
  }
  return {};
}

Result<TextLayout> find_layout(const InputFile& file, const ReadOptions& options, Window& window) {
  for (std::uint64_t bytes = kTextHeadBytes;; bytes *= 4) {
    const bool whole = bytes >= file.size();
    if (const Status read = load(file, 0, std::min(bytes, file.size()), window); !read.ok()) return read;
    auto layout = text_layout(file.path(), window.text(), whole, options);
    if (layout) return std::move(*layout);
    RCB_CHECK(!whole, "the whole of a file always has a layout");
  }
}

// An XYZ file must have exactly as many rows as its first line claims.
Status check_row_count(const InputFile& file, const TextLayout& layout, const Window& whole,
                       const ReadOptions& options) {
  const std::string_view text = whole.text();
  std::uint64_t rows = 0;
  std::size_t at = layout.data_begin;
  while (const auto row = next_row(text, at)) {
    if (rows++ == *layout.row_count) {
      const auto line = line_at(file, static_cast<std::uint64_t>(row->data() - text.data()));
      if (!line.ok()) return line.status();
      return Status(Code::invalid_argument,
                    fmt::format("{}:{}: more rows than the {} of the count line", file.path(), *line,
                                options.below == nullptr ? std::to_string(*layout.row_count) : "number"),
                    "is the first line right? A file of several frames is a trajectory, for rcbctl replay");
    }
  }
  if (rows == *layout.row_count) return {};
  if (rows + 1 == *layout.row_count && layout.comment_is_row)
    return Status(Code::invalid_argument, file.path() + ":2: is a row, where XYZ has a comment behind the count",
                  "remove the count, or put a line between");
  return Status(Code::invalid_argument,
                fmt::format("{}: its count line says {} rows, it has {}", file.path(),
                            options.below == nullptr ? std::to_string(*layout.row_count) : "another number of", rows),
                "the file was cut short, or its first line is wrong");
}

// The error for two rows with the same id; it names their lines.
Status duplicate_id(const InputFile& file, const TextLayout& layout, const Window& whole, std::size_t first,
                    std::size_t second, std::int64_t id) {
  std::array<std::uint64_t, 2> lines{};
  const std::string_view text = whole.text();
  std::size_t at = layout.data_begin;
  std::size_t row_number = 0;
  while (const auto row = next_row(text, at)) {
    for (const std::size_t which : {0U, 1U}) {
      if (row_number != (which == 0 ? first : second)) continue;
      const auto line = line_at(file, static_cast<std::uint64_t>(row->data() - text.data()));
      if (!line.ok()) return line.status();
      lines[which] = *line;
    }
    ++row_number;
  }
  return Status(Code::invalid_argument,
                fmt::format("{}:{}: id {} stands in line {} already", file.path(), lines[1], id, lines[0]),
                "give every particle an id of its own; numpy.savetxt writes whole numbers in full with fmt='%d'");
}

}  // namespace

Result<TextLayout> text_layout_of(const InputFile& file, const ReadOptions& options) {
  Window window;
  return find_layout(file, options, window);
}

Status visit_fields(const InputFile& file, const TextLayout& layout,
                    const std::function<void(const std::vector<std::string_view>&)>& visit) {
  Window window;
  if (Status read = load(file, 0, file.size(), window); !read.ok()) return read;
  std::size_t at = layout.data_begin;
  while (const auto row = next_row(window.text(), at)) visit(split_fields(*row, layout.separator));
  return {};
}

Result<Points> read_text(const InputFile& file, const ReadOptions& options, int k, int of) {
  Window window;
  const auto layout = find_layout(file, options, window);
  if (!layout.ok()) return layout.status();
  const bool xyz = layout->row_count.has_value();
  if (xyz || of == 1) {
    if (const Status read = load(file, 0, file.size(), window); !read.ok()) return read;
  }
  if (xyz) {
    if (const Status count = check_row_count(file, *layout, window, options); !count.ok()) return count;
  }
  Window share;
  if (of > 1) {
    if (const Status read = load_share(file, layout->data_begin, k, of, share); !read.ok()) return read;
  }
  const std::string_view text = of > 1 ? share.text() : window.text().substr(layout->data_begin);
  const std::uint64_t begin = of > 1 ? share.begin : layout->data_begin;

  Points points = make_points(layout->columns, 0);
  if (const auto refused = parse_rows(text, *layout, points)) {
    const auto line = line_at(file, begin + static_cast<std::uint64_t>(refused->data() - text.data()));
    return line.ok() ? row_fault(file.path(), *line, *refused, *layout, options) : line.status();
  }
  if (of == 1) {
    if (const auto twice = find_duplicate(points.id)) {
      return duplicate_id(file, *layout, window, twice->first, twice->second, points.id[twice->first]);
    }
  }
  return points;
}

}  // namespace rcb::io
