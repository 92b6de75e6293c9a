// The layout of a text file, from its first lines: separator, header, columns, XYZ.
#include <algorithm>
#include <array>

#include <fmt/format.h>

#include "common/io/formats/comment_names.hpp"
#include "common/io/formats/fields.hpp"
#include "common/io/formats/text.hpp"

namespace rcb::io {
namespace {

// next() returns the trimmed line at `at` and moves `at` behind it; nullopt if the line isn't complete. whole: true if
// `text` ends where the file does.
struct Lines {
  std::string_view text;
  bool whole;
  std::size_t at = 0;

  std::optional<std::string_view> next() {
    const std::size_t end = text.find('\n', at);
    if (end == std::string_view::npos && (!whole || at >= text.size())) return std::nullopt;
    const std::size_t begin = at;
    at = end == std::string_view::npos ? text.size() : end + 1;
    return trimmed(text.substr(begin, std::min(end, text.size()) - begin));
  }
};

bool is_xyz_name(const std::string& file) {
  const std::string name = lowered(file);
  return name.ends_with(".xyz") || name.ends_with(".xyz.gz");
}

// "Properties=species:S:1:pos:R:3" of an extended XYZ comment, as column names; empty where they can't be read.
std::vector<std::string> xyz_properties(std::string_view text) {
  if (!text.empty() && text.front() == '"') text.remove_prefix(1);
  text = text.substr(0, text.find_first_of(" \t\""));
  std::vector<std::string> words;
  while (!text.empty()) {
    const std::size_t colon = std::min(text.find(':'), text.size());
    words.emplace_back(text.substr(0, colon));
    text.remove_prefix(std::min(colon + 1, text.size()));
  }
  if (words.size() % 3 != 0) return {};
  std::vector<std::string> names;
  for (std::size_t w = 0; w < words.size(); w += 3) {
    const auto width = lone_count(words[w + 2]);
    if (!width || *width > 64) return {};
    for (std::uint64_t c = 0; c < *width; ++c) {
      const bool position = words[w] == "pos" && c < 3;
      names.push_back(position      ? std::string(1, static_cast<char>('x' + c))
                      : *width == 1 ? words[w]
                                    : fmt::format("{}:{}", words[w], c));
    }
  }
  return names;
}

// The columns as an XYZ file's second line names them or, without that, as every such file has them.
Result<std::vector<std::string>> xyz_names(const std::string& file, std::string_view comment,
                                           std::string_view first_row) {
  constexpr std::string_view kKey = "Properties=";
  const auto fields = split_fields(first_row, kBlankSeparator);
  if (const std::size_t begin = comment.find(kKey); begin != std::string_view::npos) {
    std::vector<std::string> names = xyz_properties(comment.substr(begin + kKey.size()));
    if (!names.empty() && (names.size() == fields.size() || fields.empty())) return names;
    return Status(Code::invalid_argument,
                  names.empty() ? file + ":2: its Properties can't be read"
                                : fmt::format("{}:2: its Properties are {} columns, but its first row has {}", file,
                                              names.size(), fields.size()),
                  "correct them (as in Properties=species:S:1:pos:R:3), or leave them out");
  }
  std::vector<std::string> names{"x", "y", "z"};
  if (fields.empty()) return names;
  // The element's symbol or number comes first; without it at most three numbers stand there.
  const bool element = fields.size() > 3 || !number_in(fields[0]);
  names.assign(fields.size(), "");
  if (element) names[0] = "element";
  for (std::size_t c = element ? 1 : 0, a = 0; c < fields.size() && a < 3; ++c, ++a)
    names[c] = std::string(1, static_cast<char>('x' + a));
  return names;
}

// True for two lines of as many numbers.
bool is_row_like(std::string_view line, std::string_view row) {
  const auto fields = split_fields(line, kBlankSeparator);
  return !fields.empty() && fields.size() == split_fields(row, kBlankSeparator).size() &&
         std::all_of(fields.begin(), fields.end(), [](std::string_view field) { return number_in(field).has_value(); });
}

// The layout of an XYZ file. nullopt: more of the file is needed; a result without a layout: it is no XYZ file.
std::optional<Result<std::optional<TextLayout>>> xyz_layout(const std::string& file, Lines lines,
                                                            const ReadOptions& options) {
  const auto first = lines.next();
  if (!first && !lines.whole) return std::nullopt;
  const auto count = first ? lone_count(*first) : std::nullopt;
  if (!count) return Result(std::optional<TextLayout>{});
  const auto comment = lines.next();
  if (!comment && !lines.whole) return std::nullopt;
  TextLayout layout;
  layout.data_begin = lines.at;
  layout.row_count = count;
  const auto third = lines.next();
  if (!third && !lines.whole) return std::nullopt;
  const std::string_view row = third.value_or(std::string_view{});
  // A text file with one column of numbers looks the same up to here.
  if (!is_xyz_name(file) && split_fields(row, kBlankSeparator).size() < 2) return Result(std::optional<TextLayout>{});
  auto names = xyz_names(file, comment.value_or(std::string_view{}), row);
  if (!names.ok()) return Result<std::optional<TextLayout>>(names.status());
  layout.names = std::move(*names);
  layout.comment_is_row = is_row_like(comment.value_or(std::string_view{}), row);
  layout.column_count = layout.names.size();
  auto columns = choose_columns(file, options, layout.names, layout.column_count);
  if (!columns.ok()) return Result<std::optional<TextLayout>>(columns.status());
  layout.columns = *columns;
  return Result(std::optional(std::move(layout)));
}

// True for a field meant as a number, even a broken or a missing one: its row must not pass for a header and be lost.
bool begins_as_number(std::string_view field) {
  constexpr std::array<std::string_view, 5> kMissing{"na", "n/a", "null", "none", "missing"};
  // A minus sign, dashes and spaces of typography, a no-break space. Below: Fortran fills a field that is too short for
  // its number with asterisks.
  constexpr std::array<std::string_view, 4> kNoNames{"\u2212", "\xE2\x80", "\u00A0", kByteOrderMark};
  if (field.empty()) return false;
  const auto first = static_cast<unsigned char>(field[0]);
  return number_in(field) || first <= 0x20 || first == 0x7F || (first >= '0' && first <= '9') ||
         std::string_view("+-.*#").find(field[0]) != std::string_view::npos ||
         std::any_of(kNoNames.begin(), kNoNames.end(), [&](auto begin) { return field.starts_with(begin); }) ||
         std::find(kMissing.begin(), kMissing.end(), lowered(std::string(field))) != kMissing.end();
}

bool is_named(std::string_view field) {
  if (field.size() == 2) return (field[0] | 0x20) == 'i' && (field[1] | 0x20) == 'd';
  return field.size() == 1 && (field[0] | 0x20) >= 'x' && (field[0] | 0x20) <= 'z';
}

// Moves behind blank lines and comments, to the first line that is neither and that is returned; `begin` is where it
// begins. nullopt: there is none, or more of the file is needed.
std::optional<std::string_view> skip_comments(Lines& lines, std::size_t& begin) {
  // What Excel writes for a cell without a value would take its row along.
  constexpr std::array<std::string_view, 7> kErrors{"#n/a", "#div/0!", "#ref!", "#value!", "#name?", "#num!", "#null!"};
  begin = lines.at;
  auto line = lines.next();
  for (; line; line = lines.next()) {
    const std::string start = lowered(std::string(line->substr(0, 8)));
    const bool error = std::any_of(kErrors.begin(), kErrors.end(), [&](auto word) { return start.starts_with(word); });
    if (!line->empty() && (line->front() != '#' || error)) break;
    begin = lines.at;
  }
  return line;
}

bool is_header(std::span<const std::string_view> fields) {
  const auto is_number = [](std::string_view field) { return number_in(field).has_value(); };
  return std::none_of(fields.begin(), fields.end(), begins_as_number) ||
         (std::any_of(fields.begin(), fields.end(), is_named) && !std::all_of(fields.begin(), fields.end(), is_number));
}

// What a first line other than a comment says that is neither a header nor a row.
Status check_first_line(const std::string& file, std::string_view line, std::optional<std::string_view> next) {
  if (lowered(std::string(line)).starts_with("sep=") || lowered(std::string(line)).starts_with("\"sep="))
    return {Code::invalid_argument, file + ": its first line, sep=, is for Excel alone",
            "remove it: the separator is found without it"};
  if (has_decimal_commas(line) && split_fields(line, kBlankSeparator).size() > 1)
    return {Code::invalid_argument, file + ": its numbers have decimal commas", "write them with points, as in 1.5"};
  const std::size_t columns = next ? split_fields(*next, separator_of(*next)).size() : 0;
  if (lone_count(line) && columns > 1)
    return {Code::invalid_argument,
            fmt::format("{}: its first line is one number alone, before rows of {} columns", file, columns),
            "if it is the number of points, remove it"};
  return {};
}

// Without any row there is nothing that could have columns.
Result<TextLayout> empty_layout(const std::string& file, const ReadOptions& options, TextLayout layout) {
  layout.columns.dims = !options.columns.empty() ? static_cast<int>(options.columns.size())
                        : options.dims == 0      ? 3
                                                 : options.dims;
  if (layout.columns.dims < 1 || layout.columns.dims > 3) return choose_columns(file, options, {}, 0).status();
  return layout;
}

// How many rows `text` has, if that is all of the file.
std::optional<std::uint64_t> count_rows(std::string_view text, bool whole) {
  if (!whole) return std::nullopt;
  std::uint64_t rows = 0;
  for (std::size_t at = 0; next_row(text, at);) ++rows;
  return rows;
}

}  // namespace

std::optional<Result<TextLayout>> text_layout(const std::string& file, std::string_view head, bool whole,
                                              const ReadOptions& options) {
  Lines lines{head, whole};
  if (head.substr(0, kByteOrderMark.size()) == kByteOrderMark) lines.at = kByteOrderMark.size();
  auto xyz = xyz_layout(file, lines, options);
  if (!xyz) return std::nullopt;
  if (!xyz->ok()) return Result<TextLayout>(xyz->status());
  if (xyz->value()) return Result<TextLayout>(std::move(*xyz->value()));

  TextLayout layout;
  const std::size_t begin = lines.at;
  const auto line = skip_comments(lines, layout.data_begin);
  if (!line) return whole ? std::optional(empty_layout(file, options, std::move(layout))) : std::nullopt;
  const std::string_view comments = head.substr(begin, layout.data_begin - begin);
  std::size_t next_begin = 0;
  const auto next = skip_comments(lines, next_begin);
  if (!next && !whole) return std::nullopt;
  if (Status good = check_first_line(file, *line, next); !good.ok()) return Result<TextLayout>(good);
  layout.separator = separator_of(*line);
  const auto fields = split_fields(*line, layout.separator);
  layout.column_count = fields.size();
  if (is_header(fields)) {
    layout.names.assign(fields.begin(), fields.end());
    layout.data_begin = next_begin;
  } else {
    layout.names = names_in_comments(comments, layout.column_count, options);
  }
  auto columns = choose_columns(file, options, layout.names, layout.column_count,
                                count_rows(head.substr(layout.data_begin), whole));
  if (!columns.ok()) return Result<TextLayout>(columns.status());
  layout.columns = *columns;
  return Result<TextLayout>(std::move(layout));
}

}  // namespace rcb::io
