// The fields of a line of text: splitting for headers and faults, and number syntax.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace rcb::io {

// Separators are ',', ';' or this one, which stands for any run of spaces and tabs.
constexpr char kBlankSeparator = ' ';

// May stand before a text in UTF-8.
constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";

inline bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\f' || c == '\v'; }
std::string_view trimmed(std::string_view text);
std::string lowered(std::string text);  // ASCII letters
// The name of a column in lower case, without a unit in brackets behind it: "x" of "X [m]".
std::string plain_name(std::string_view name);
// Whether these are numbers with decimal commas, with blanks between: "1,5\t2,5".
bool has_decimal_commas(std::string_view line);

char separator_of(std::string_view line);
// Fields come trimmed and without quotes; a separator at the end of the line adds no empty field.
std::vector<std::string_view> split_fields(std::string_view line, char separator);

// Any usual syntax: -.5, +2, 1e3, 1.5D+02, nan, inf, in quotes too. nullopt if it is no number.
std::optional<double> number_in(std::string_view field);
// A line that is a whole number >= 0 and nothing else, as an XYZ file's first.
std::optional<std::uint64_t> lone_count(std::string_view line);
// 0 .. 2^63-1, written as an integer, or as a decimal that is whole and below 2^53.
std::optional<std::int64_t> id_in(std::string_view field);

}  // namespace rcb::io
