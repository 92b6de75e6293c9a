// The layout of a text file, from its first lines: separator, header, columns, XYZ.
#include <algorithm>
#include <array>
#include <charconv>

#include "common/io/formats/fields.hpp"
#include "common/io/formats/text.hpp"

namespace rcb::io {
namespace {

constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";

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

bool is_xyz_name(const std::string& file) { return lowered(file).ends_with(".xyz"); }

std::optional<std::uint64_t> lone_count(std::string_view line) {
  std::uint64_t count = 0;
  const auto [end, error] = std::from_chars(line.data(), line.data() + line.size(), count);
  if (line.empty() || error != std::errc{} || end != line.data() + line.size()) return std::nullopt;
  return count;
}

// "Properties=species:S:1:pos:R:3" of an extended XYZ comment, as column names; empty where there are none.
std::vector<std::string> xyz_properties(std::string_view comment) {
  constexpr std::string_view kKey = "Properties=";
  const std::size_t begin = comment.find(kKey);
  if (begin == std::string_view::npos) return {};
  std::string_view text = comment.substr(begin + kKey.size());
  if (!text.empty() && text.front() == '"') text.remove_prefix(1);
  text = text.substr(0, text.find_first_of(" \t\""));
  std::vector<std::string> words;
  while (!text.empty()) {
    const std::size_t colon = std::min(text.find(':'), text.size());
    words.emplace_back(text.substr(0, colon));
    text.remove_prefix(std::min(colon + 1, text.size()));
  }
  std::vector<std::string> names;
  for (std::size_t w = 0; w + 2 < words.size(); w += 3) {
    const auto width = lone_count(words[w + 2]);
    if (!width || *width > 64) return {};
    for (std::uint64_t c = 0; c < *width; ++c) {
      const bool position = words[w] == "pos" && c < 3;
      names.push_back(position ? std::string(1, static_cast<char>('x' + c)) : *width == 1 ? words[w] : "");
    }
  }
  return names;
}

std::vector<std::string> xyz_names(std::string_view comment, std::string_view first_row) {
  std::vector<std::string> names = xyz_properties(comment);
  const auto fields = split_fields(first_row, kBlankSeparator);
  if (names.size() == fields.size() || fields.empty())
    return names.empty() ? std::vector<std::string>{"x", "y", "z"} : names;
  // The element's symbol or number comes first; without it at most three numbers stand there.
  const bool element = fields.size() > 3 || !number_in(fields[0]);
  names.assign(fields.size(), "");
  if (element) names[0] = "element";
  for (std::size_t c = element ? 1 : 0, a = 0; c < fields.size() && a < 3; ++c, ++a) {
    names[c] = std::string(1, static_cast<char>('x' + a));
  }
  return names;
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
  layout.names = xyz_names(comment.value_or(std::string_view{}), row);
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
         std::string_view("+-.*").find(field[0]) != std::string_view::npos ||
         std::any_of(kNoNames.begin(), kNoNames.end(), [&](auto begin) { return field.starts_with(begin); }) ||
         std::find(kMissing.begin(), kMissing.end(), lowered(std::string(field))) != kMissing.end();
}

bool is_named(std::string_view field) {
  if (field.size() == 2) return (field[0] | 0x20) == 'i' && (field[1] | 0x20) == 'd';
  return field.size() == 1 && (field[0] | 0x20) >= 'x' && (field[0] | 0x20) <= 'z';
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
  layout.data_begin = lines.at;
  auto line = lines.next();
  for (; line && (line->empty() || line->front() == '#'); line = lines.next()) layout.data_begin = lines.at;
  if (!line && !whole) return std::nullopt;
  if (!line) {
    layout.columns.dims = options.dims == 0 ? 3 : options.dims;
    if (layout.columns.dims < 1 || layout.columns.dims > 3)
      return Result<TextLayout>(choose_columns(file, options, {}, 0).status());
    return Result<TextLayout>(std::move(layout));
  }
  layout.separator = separator_of(*line);
  const auto fields = split_fields(*line, layout.separator);
  layout.column_count = fields.size();
  const auto is_number = [](std::string_view field) { return number_in(field).has_value(); };
  const bool header =
      std::none_of(fields.begin(), fields.end(), begins_as_number) ||
      (std::any_of(fields.begin(), fields.end(), is_named) && !std::all_of(fields.begin(), fields.end(), is_number));
  if (header) {
    layout.names.assign(fields.begin(), fields.end());
    layout.data_begin = lines.at;
  }
  auto columns = choose_columns(file, options, layout.names, layout.column_count);
  if (!columns.ok()) return Result<TextLayout>(columns.status());
  layout.columns = *columns;
  return Result<TextLayout>(std::move(layout));
}

}  // namespace rcb::io
