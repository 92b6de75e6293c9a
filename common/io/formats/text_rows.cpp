// The fast loop over rows of text, and the error messages for rows that it refused.
#include <array>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>

#include <fast_float/fast_float.h>
#include <fmt/format.h>

#include "common/io/formats/fields.hpp"
#include "common/io/formats/text.hpp"

namespace rcb::io {
namespace {

constexpr const char* kCommentHint = "correct the line; if it is a comment, it needs a blank behind its #";

enum class Role : std::uint8_t { skip, position, id, weight };

struct Column {
  Role role = Role::skip;
  std::size_t axis = 0;
};

std::vector<Column> roles_of(const TextLayout& layout) {
  std::vector<Column> roles(layout.column_count);
  for (std::size_t a = 0; a < static_cast<std::size_t>(layout.columns.dims); ++a) {
    if (layout.columns.axis[a] < roles.size()) roles[layout.columns.axis[a]] = {Role::position, a};
  }
  if (layout.columns.id < roles.size()) roles[layout.columns.id].role = Role::id;
  return roles;
}

// Parses one row into values, and only then stores these, so that a refused row leaves nothing behind.
class RowParser {
 public:
  explicit RowParser(const TextLayout& layout)
      : roles_(roles_of(layout)),
        blank_(layout.separator == kBlankSeparator),
        separator_(layout.separator),
        weight_column_(layout.columns.weight) {}

  // p: the first character that isn't blank; end: behind the last.
  bool parse(const char* p, const char* end) {
    const std::size_t last = roles_.size() - 1;
    for (std::size_t c = 0; c <= last; ++c) {
      if (!field(c, p, end)) return false;
      while (p < end && is_blank(*p)) ++p;
      if (c == last) break;
      if (p == end) return false;
      if (!blank_) {
        if (*p != separator_) return false;
        ++p;
        while (p < end && is_blank(*p)) ++p;
        // An empty last field is accepted where its column isn't used.
        if (p == end) return c + 1 == last && roles_[last].role == Role::skip && last != weight_column_;
      }
    }
    if (p < end && !blank_ && *p == separator_) ++p;  // a trailing separator
    return p == end;
  }

  std::array<double, 3> position{};
  std::int64_t id = 0;
  double weight = 0;

 private:
  bool ends(const char* p, const char* end) const { return p == end || is_blank(*p) || (!blank_ && *p == separator_); }

  // The end of the field at p, for fields that the fast path doesn't take.
  const char* field_end(const char* p, const char* end) const {
    if (p < end && *p == '"') {
      const void* close = std::memchr(p + 1, '"', static_cast<std::size_t>(end - p - 1));
      if (close != nullptr) p = static_cast<const char*>(close) + 1;
    }
    while (p < end && !(blank_ ? is_blank(*p) : *p == separator_)) ++p;
    return p;
  }

  bool number(const char*& p, const char* end, double& value) const {
    const auto [stop, error] = fast_float::from_chars(p, end, value);
    if (error == std::errc{} && ends(stop, end)) {
      p = stop;
    } else {
      const char* behind = field_end(p, end);
      const auto slow = number_in(std::string_view(p, static_cast<std::size_t>(behind - p)));
      if (!slow) return false;
      value = *slow;
      p = behind;
    }
    return std::fabs(value) <= std::numeric_limits<double>::max();
  }

  bool field(std::size_t c, const char*& p, const char* end) {
    const Column& column = roles_[c];
    if (c == weight_column_) {
      const char* begin = p;
      if (!number(p, end, weight) || weight < 0) return false;
      if (column.role == Role::skip) return true;
      p = begin;
    }
    if (column.role == Role::position) return number(p, end, position[column.axis]);
    const char* behind = column.role == Role::skip ? field_end(p, end) : p;
    if (column.role == Role::id) {
      const auto [stop, error] = std::from_chars(p, end, id);
      if (error == std::errc{} && ends(stop, end) && id >= 0) {
        behind = stop;
      } else {
        behind = field_end(p, end);
        const auto slow = id_in(std::string_view(p, static_cast<std::size_t>(behind - p)));
        if (!slow) return false;
        id = *slow;
      }
    }
    p = behind;
    return true;
  }

  std::vector<Column> roles_;
  bool blank_;
  char separator_;
  std::size_t weight_column_;
};

}  // namespace

std::optional<std::string_view> next_row(std::string_view text, std::size_t& at) {
  while (at < text.size()) {
    const void* found = std::memchr(text.data() + at, '\n', text.size() - at);
    const std::size_t end =
        found == nullptr ? text.size() : static_cast<std::size_t>(static_cast<const char*>(found) - text.data());
    std::size_t begin = at;
    at = found == nullptr ? end : end + 1;
    while (begin < end && is_blank(text[begin])) ++begin;
    const bool comment = begin < end && text[begin] == '#' && (begin + 1 == end || is_blank(text[begin + 1]));
    if (begin == end || comment) continue;
    std::size_t behind = end;
    while (is_blank(text[behind - 1])) --behind;
    return text.substr(begin, behind - begin);
  }
  return std::nullopt;
}

std::optional<std::string_view> parse_rows(std::string_view text, const TextLayout& layout, Points& points) {
  const auto dims = static_cast<std::size_t>(layout.columns.dims);
  RowParser parser(layout);
  std::size_t at = 0;
  while (const auto row = next_row(text, at)) {
    if (layout.column_count == 0 || !parser.parse(row->data(), row->data() + row->size())) return row;
    if (points.count == 0) {
      // Estimated from the length of the first row, with an eighth to spare.
      const std::size_t expected = text.size() / (row->size() + 1) + text.size() / (row->size() + 1) / 8 + 1;
      for (auto& axis : points.position) axis.reserve(expected);
      if (layout.columns.id != kNoColumn) points.id.reserve(expected);
      if (layout.columns.weighted()) points.weight.reserve(expected);
    }
    for (std::size_t a = 0; a < dims; ++a) points.position[a].push_back(parser.position[a]);
    if (layout.columns.id != kNoColumn) points.id.push_back(parser.id);
    if (layout.columns.weighted()) points.weight.push_back(parser.weight);
    ++points.count;
  }
  return std::nullopt;
}

Status row_fault(const std::string& file, std::uint64_t line, std::string_view row, const TextLayout& layout,
                 const ReadOptions& options) {
  const std::string where = fmt::format("{}:{}: ", file, line);
  const auto fields = split_fields(row, layout.separator);
  const auto& columns = layout.columns;
  const std::vector<Column> roles = roles_of(layout);
  const bool like_comment = row.starts_with('#');
  for (std::size_t c = 0; c < std::min(fields.size(), roles.size()); ++c) {
    const bool weight = c == columns.weight;
    if (roles[c].role == Role::skip && !weight) continue;
    const std::string name = options.below == nullptr && c < layout.names.size() && !layout.names[c].empty()
                                 ? " (" + shown(layout.names[c]) + ")"
                                 : "";
    const std::string column = fmt::format("{}column {}{}: ", where, c + 1, name);
    const std::string text = quoted(fields[c], "its text", options);
    if (roles[c].role == Role::id) {
      if (id_in(fields[c])) continue;
      return Status(Code::invalid_argument, fmt::format("{}{} is not an id", column, text),
                    "ids are whole numbers from 0 to 9223372036854775807; --ids says which column holds them");
    }
    const auto value = number_in(fields[c]);
    if (!value && fields.size() == roles.size()) {
      return Status(Code::invalid_argument, fmt::format("{}{} is not a number", column, text),
                    like_comment                    ? kCommentHint
                    : has_decimal_commas(fields[c]) ? "write numbers with a decimal point, as in 1.5"
                                                    : "correct the line; numbers are written like 1.5 or -2e3");
    }
    if (value && !std::isfinite(*value)) {
      return Status(Code::not_finite, fmt::format("{}{} is not a finite number", column, text),
                    "correct the line or leave it out");
    }
    if (value && weight && *value < 0) {
      return Status(Code::invalid_argument, fmt::format("{}the weight {} is negative", column, text),
                    "weights are 0 or more");
    }
  }
  return Status(Code::invalid_argument,
                fmt::format("{}{} column{}, but the file's first line has {}", where, fields.size(),
                            fields.size() == 1 ? "" : "s", layout.column_count),
                like_comment ? kCommentHint : "give every line the same columns");
}

}  // namespace rcb::io
