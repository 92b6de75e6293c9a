#include "common/io/formats/comment_names.hpp"

#include <algorithm>
#include <array>
#include <optional>

#include "common/io/formats/fields.hpp"

namespace rcb::io {
namespace {

using Words = std::vector<std::string_view>;

// They make a sentence of a comment.
constexpr auto kSentenceWords = std::to_array<std::string_view>(
    {"all",  "an",  "and",  "are",   "as",    "at",   "be",   "by", "each", "every", "for",  "from",  "has", "have",
     "if",   "in",  "into", "is",    "it",    "its",  "not",  "of", "on",   "one",   "only", "or",    "our", "per",
     "that", "the", "then", "there", "these", "they", "this", "to", "was",  "were",  "we",   "which", "with"});
constexpr auto kQuantities = std::to_array<std::string_view>(
    {"acceleration", "alpha",    "alt",     "altitude", "angle",     "beta",        "bond",      "charge",   "cluster",
     "color",        "colour",   "density", "depth",    "diameter",  "easting",     "elevation", "element",  "energy",
     "force",        "gamma",    "group",   "height",   "ids",       "index",       "kind",      "label",    "lat",
     "latitude",     "level",    "lon",     "long",     "longitude", "mass",        "mol",       "molecule", "northing",
     "number",       "phi",      "pos",     "pressure", "proc",      "radius",      "rank",      "rho",      "row",
     "size",         "species",  "speed",   "step",     "temp",      "temperature", "theta",     "time",     "type",
     "vel",          "velocity", "volume",  "weight"});

template <std::size_t kCount>
bool is_one_of(const std::array<std::string_view, kCount>& words, std::string_view field) {
  return std::find(words.begin(), words.end(), lowered(std::string(field))) != words.end();
}

bool is_digit(char c) { return c >= '0' && c <= '9'; }
bool is_letter(char c) { return (c | 0x20) >= 'a' && (c | 0x20) <= 'z'; }

// A word that no name looks like.
bool breaks_names(std::string_view word) {
  if (word.empty() || is_one_of(kSentenceWords, word)) return true;
  const std::size_t colon = word.find(':');
  const bool numbered = colon < word.size() - 1 && is_letter(word[colon + 1]);  // "1:x"
  return (is_digit(word[0]) && !numbered) || std::string_view(".,!?").find(word.back()) != std::string_view::npos ||
         word.find_first_of("=@") != std::string_view::npos || word.find("//") != std::string_view::npos;
}

bool looks_like_a_name(std::string_view field) {
  const Words words = split_fields(field, kBlankSeparator);
  return std::any_of(words.begin(), words.end(), [](std::string_view word) {
    const bool letters = std::all_of(word.begin(), word.end(), is_letter);
    return (letters && word.size() <= 2) || is_one_of(kQuantities, word) ||
           word.find_first_of("0123456789_[](){}:^") != std::string_view::npos;
  });
}

bool is_unit(std::string_view field) {
  return field.size() >= 2 &&
         ((field.front() == '[' && field.back() == ']') || (field.front() == '(' && field.back() == ')'));
}

// The text of a comment behind its #.
std::string_view body_of(std::string_view line) {
  while (!line.empty() && (line.front() == '#' || line.front() == '!' || is_blank(line.front()))) line.remove_prefix(1);
  return line;
}

struct Reading {
  Words fields;
  bool listed;  // whether it is a list of words with commas, semicolons or tabs between, or in quotes
};

// The comment as so many fields, if it can be read so.
std::optional<Reading> read_as(std::string_view text, std::size_t column_count) {
  for (const char separator : {separator_of(text), '\t', kBlankSeparator}) {
    Words fields = split_fields(text, separator);
    if (fields.size() != column_count) std::erase_if(fields, is_unit);
    if (fields.size() != column_count) continue;
    const auto is_word = [](std::string_view field) { return split_fields(field, kBlankSeparator).size() == 1; };
    const bool listed =
        separator != kBlankSeparator && column_count > 1 && std::all_of(fields.begin(), fields.end(), is_word);
    return Reading{std::move(fields), listed || text.find('"') != std::string_view::npos};
  }
  return std::nullopt;
}

// Without the words before a colon, if it fits so.
std::optional<Reading> read_comment(std::string_view line, std::size_t column_count) {
  // The # of "#,x,y" is a name of its own.
  if (line.size() > 1 && std::string_view(",;\t").find(line[1]) != std::string_view::npos)
    if (auto reading = read_as(line, column_count)) return reading;
  const std::string_view body = trimmed(body_of(line));
  if (const std::size_t label = body.find(": "); label != std::string_view::npos)
    if (auto reading = read_as(trimmed(body.substr(label + 1)), column_count)) return reading;
  return read_as(body, column_count);
}

bool can_be_names(const Words& fields) {
  return std::none_of(fields.begin(), fields.end(), [](std::string_view field) {
    const Words words = split_fields(field, kBlankSeparator);
    return number_in(field) || words.empty() || std::any_of(words.begin(), words.end(), breaks_names);
  });
}

bool names_x(const Words& fields) {
  constexpr std::array<std::string_view, 3> kX{"x", "points:0", "points_0"};
  return std::any_of(fields.begin(), fields.end(),
                     [&](std::string_view field) { return is_one_of(kX, plain_name(field)); });
}

bool names_asked(const Words& fields, const ReadOptions& options) {
  std::vector<std::string> asked(options.columns);
  asked.insert(asked.end(), {options.ids, options.weights});
  return std::any_of(fields.begin(), fields.end(), [&](std::string_view field) {
    const std::string name = lowered(std::string(field));
    return std::any_of(asked.begin(), asked.end(), [&](const std::string& column) { return lowered(column) == name; });
  });
}

bool look_like_names(const Reading& reading) {
  const auto names = std::count_if(reading.fields.begin(), reading.fields.end(), looks_like_a_name);
  const bool id = std::any_of(reading.fields.begin(), reading.fields.end(),
                              [](std::string_view field) { return plain_name(field) == "id"; });
  return reading.listed || id || static_cast<std::size_t>(names) * 2 > reading.fields.size();
}

}  // namespace

std::vector<std::string> names_in_comments(std::string_view lines, std::size_t column_count,
                                           const ReadOptions& options) {
  std::vector<std::string> sure, likely;
  for (std::size_t at = 0; at < lines.size();) {
    const std::size_t end = std::min(lines.find('\n', at), lines.size());
    const std::string_view line = trimmed(lines.substr(at, end - at));
    at = end + 1;
    if (line.empty()) continue;
    const auto reading = read_comment(line, column_count);
    if (!reading || !can_be_names(reading->fields)) continue;
    const std::vector<std::string> names(reading->fields.begin(), reading->fields.end());
    if (names_x(reading->fields) || names_asked(reading->fields, options)) sure = names;
    if (look_like_names(*reading)) likely = names;
  }
  return sure.empty() ? likely : sure;
}

}  // namespace rcb::io
