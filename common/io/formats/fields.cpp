#include "common/io/formats/fields.hpp"

#include <algorithm>
#include <array>
#include <charconv>

#include <fast_float/fast_float.h>

namespace rcb::io {
namespace {

std::string_view unquoted(std::string_view field) {
  field = trimmed(field);
  if (field.size() >= 2 && (field.front() == '"' || field.front() == '\'') && field.back() == field.front()) {
    field = trimmed(field.substr(1, field.size() - 2));
  }
  return field;
}

// True if the digits of a number >= 0 say that it is whole: a double rounds others to whole ones, too.
bool is_whole(std::string_view field) {
  const std::string_view mantissa = field.substr(0, field.find_first_of("eEdD"));
  int exponent = 0;
  if (mantissa.size() < field.size()) {
    std::string_view text = field.substr(mantissa.size() + 1);
    if (text.starts_with('+')) text.remove_prefix(1);
    if (std::from_chars(text.data(), text.data() + text.size(), exponent).ec != std::errc{}) return false;
  }
  std::int64_t place = static_cast<std::int64_t>(std::min(mantissa.find('.'), mantissa.size())) + exponent;
  for (const char c : mantissa)
    if (c != '.' && --place < 0 && c != '0') return false;
  return true;
}

// The end of the field that begins at `begin`; a separator in double quotes does not end it.
std::size_t field_end(std::string_view line, std::size_t begin, char separator) {
  std::size_t at = begin;
  if (at < line.size() && line[at] == '"') {
    const std::size_t close = line.find('"', at + 1);
    if (close != std::string_view::npos) at = close + 1;
  }
  while (at < line.size() && !(separator == kBlankSeparator ? is_blank(line[at]) : line[at] == separator)) ++at;
  return at;
}

}  // namespace

std::string_view trimmed(std::string_view text) {
  while (!text.empty() && is_blank(text.front())) text.remove_prefix(1);
  while (!text.empty() && is_blank(text.back())) text.remove_suffix(1);
  return text;
}

std::string lowered(std::string text) {
  for (char& c : text) c = static_cast<char>(c >= 'A' && c <= 'Z' ? c | 0x20 : c);
  return text;
}

std::string plain_name(std::string_view name) {
  name = trimmed(name);
  const std::size_t open = name.find_last_of("[(");
  const bool unit = open != std::string_view::npos && open > 0 && open + 2 < name.size() &&
                    name.back() == (name[open] == '[' ? ']' : ')') && (name[open + 1] < '0' || name[open + 1] > '9');
  return lowered(std::string(unit ? trimmed(name.substr(0, open)) : name));
}

bool has_decimal_commas(std::string_view line) {
  bool any = false;
  for (const std::string_view field : split_fields(line, kBlankSeparator)) {
    std::string text(field);
    const std::size_t comma = text.find(',');
    if (comma != std::string::npos) text[comma] = '.';
    if (!number_in(text) || (comma != std::string::npos && (comma + 1 == text.size() || comma == 0))) return false;
    any = any || comma != std::string::npos;
  }
  return any;
}

char separator_of(std::string_view line) {
  // Semicolons first: beside them a comma can only be a decimal one, which is then reported as no number.
  if (line.find(';') != std::string_view::npos) return ';';
  if (line.find(',') != std::string_view::npos) return ',';
  return kBlankSeparator;
}

std::vector<std::string_view> split_fields(std::string_view line, char separator) {
  std::vector<std::string_view> fields;
  line = trimmed(line);
  std::size_t at = 0;
  while (at < line.size()) {
    while (at < line.size() && is_blank(line[at])) ++at;
    const std::size_t end = field_end(line, at, separator);
    fields.push_back(unquoted(line.substr(at, end - at)));
    at = end + 1;
  }
  return fields;
}

std::optional<double> number_in(std::string_view field) {
  field = unquoted(field);
  if (!field.empty() && field.front() == '+') {
    field.remove_prefix(1);
    if (!field.empty() && field.front() == '-') return std::nullopt;
  }
  // Fortran writes the exponent of a double with a D.
  std::array<char, 64> copy;
  const std::size_t exponent = field.find_first_of("dD");
  if (exponent != std::string_view::npos && field.size() < copy.size()) {
    std::copy(field.begin(), field.end(), copy.begin());
    copy[exponent] = 'e';
    field = std::string_view(copy.data(), field.size());
  }
  double value = 0;
  const auto [end, error] = fast_float::from_chars(field.data(), field.data() + field.size(), value);
  if (end != field.data() + field.size() || field.empty()) return std::nullopt;
  if (error != std::errc{} && error != std::errc::result_out_of_range) return std::nullopt;
  return value;
}

std::optional<std::uint64_t> lone_count(std::string_view line) {
  std::uint64_t count = 0;
  const auto [end, error] = std::from_chars(line.data(), line.data() + line.size(), count);
  if (line.empty() || error != std::errc{} || end != line.data() + line.size()) return std::nullopt;
  return count;
}

std::optional<std::int64_t> id_in(std::string_view field) {
  field = unquoted(field);
  if (!field.empty() && field.front() == '+') field.remove_prefix(1);
  std::int64_t id = 0;
  const auto [end, error] = std::from_chars(field.data(), field.data() + field.size(), id);
  if (error == std::errc{} && end == field.data() + field.size()) return id >= 0 ? std::optional(id) : std::nullopt;
  const auto number = number_in(field);
  if (!number || !(*number >= 0) || *number >= 0x1p53 || !is_whole(field)) return std::nullopt;
  return static_cast<std::int64_t>(*number);
}

}  // namespace rcb::io
