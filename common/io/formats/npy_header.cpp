// The header of an .npy file: a Python dictionary, of which just the three known keys are read.
#include <algorithm>
#include <array>
#include <charconv>
#include <optional>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "common/base/wide.hpp"
#include "common/io/formats/npy.hpp"

namespace rcb::io {
namespace {

constexpr std::size_t kHeaderBytesMax = std::size_t{1} << 20U;
constexpr u128 kBytesMax = u128{1} << 62U;
constexpr std::size_t kItemBytesMax = std::size_t{1} << 24U;  // of an element of a structured array
constexpr std::size_t kMembersMax = 4096;

// A field of a structured type, as the header lists it; several numbers: their count as `shape`.
struct Member {
  std::string name;
  std::string descr;
  std::vector<std::uint64_t> shape;
};

struct Fields {
  std::optional<std::string> descr;  // empty for a structured type
  std::vector<Member> members;
  std::optional<bool> fortran_order;
  std::optional<std::vector<std::uint64_t>> shape;
};

// Parses the dictionary's text; every step fails on what it doesn't expect.
class Dictionary {
 public:
  explicit Dictionary(std::string_view text) : text_(text) {}

  std::optional<Fields> read() {
    Fields fields;
    if (!take('{')) return std::nullopt;
    while (!take('}')) {
      const auto key = quoted();
      if (!key || !take(':') || !value(*key, fields)) return std::nullopt;
      if (take(',')) continue;
      if (!take('}')) return std::nullopt;
      break;
    }
    skip_blanks();
    return text_.empty() ? std::optional(fields) : std::nullopt;
  }

 private:
  void skip_blanks() {
    while (!text_.empty() && (text_[0] == ' ' || text_[0] == '\n' || text_[0] == '\t')) text_.remove_prefix(1);
  }
  bool take(char c) {
    skip_blanks();
    if (text_.empty() || text_[0] != c) return false;
    text_.remove_prefix(1);
    return true;
  }
  bool take(std::string_view word) {
    skip_blanks();
    if (text_.substr(0, word.size()) != word) return false;
    text_.remove_prefix(word.size());
    return true;
  }
  std::optional<std::string> quoted() {
    skip_blanks();
    if (text_.empty() || (text_[0] != '\'' && text_[0] != '"')) return std::nullopt;
    const std::size_t end = text_.find(text_[0], 1);
    if (end == std::string_view::npos) return std::nullopt;
    std::string word(text_.substr(1, end - 1));
    text_.remove_prefix(end + 1);
    return word;
  }
  bool value(const std::string& key, Fields& fields) {
    if (key == "descr" && !fields.descr) {
      if (take('[')) {
        fields.descr.emplace();
        return members(fields.members);
      }
      fields.descr = quoted();
      return fields.descr.has_value();
    }
    if (key == "fortran_order" && !fields.fortran_order) {
      fields.fortran_order = take("True");
      return *fields.fortran_order || take("False");
    }
    return key == "shape" && !fields.shape && shape(fields.shape.emplace());
  }
  // "('x', '<f8'), ('q', '<f4', (3,))]"; instead of a name a pair (title, name) may stand.
  bool members(std::vector<Member>& members) {
    while (!take(']')) {
      Member member;
      if (members.size() == kMembersMax || !take('(')) return false;
      const bool titled = take('(');
      if (titled && (!quoted() || !take(','))) return false;
      const auto name = quoted();
      if (!name || (titled && !take(')')) || !take(',')) return false;
      const auto descr = quoted();
      if (!descr || (take(',') && !shape(member.shape)) || !take(')')) return false;
      member.name = *name;
      member.descr = *descr;
      members.push_back(std::move(member));
      if (take(',')) continue;
      if (!take(']')) return false;
      break;
    }
    return true;
  }
  bool shape(std::vector<std::uint64_t>& axes) {
    if (!take('(')) return false;
    while (!take(')')) {
      skip_blanks();
      std::uint64_t length = 0;
      const auto [end, error] = std::from_chars(text_.data(), text_.data() + text_.size(), length);
      if (error != std::errc{} || axes.size() == 64) return false;
      text_.remove_prefix(static_cast<std::size_t>(end - text_.data()));
      if (!text_.empty() && text_[0] == 'L') text_.remove_prefix(1);  // Python 2 wrote its long integers so
      axes.push_back(length);
      if (take(',')) continue;
      if (!take(')')) return false;
      break;
    }
    return true;
  }

  std::string_view text_;
};

// Of "<f8" and the like. Types that are not read, such as text, have just a size; nullopt: not even that.
std::optional<NumberType> type_of(std::string_view descr) {
  if (descr.size() < 3 || std::string_view("<>=|").find(descr[0]) == std::string_view::npos) return std::nullopt;
  NumberType type{0, descr[0] == '>', NumberType::Kind::unread};
  const auto [end, error] = std::from_chars(descr.data() + 2, descr.data() + descr.size(), type.bytes);
  const char* behind = descr.data() + descr.size();
  const bool dated = descr[1] == 'M' || descr[1] == 'm';  // "<M8[ns]"
  if (error != std::errc{} || (end != behind && !dated) || type.bytes > kItemBytesMax) return std::nullopt;
  const bool one_word = type.bytes == 1 || type.bytes == 2 || type.bytes == 4 || type.bytes == 8;
  if (descr[1] == 'f' && (type.bytes == 4 || type.bytes == 8)) type.kind = NumberType::Kind::real;
  if (descr[1] == 'i' && one_word) type.kind = NumberType::Kind::integer;
  if (descr[1] == 'u' && one_word) type.kind = NumberType::Kind::natural;
  if (descr[1] == 'U') type.bytes *= 4;
  return std::string_view("fiubcSaUVMm").find(descr[1]) == std::string_view::npos ? std::nullopt : std::optional(type);
}

Status set_type(const std::string& file, const Fields& fields, const ReadOptions& options, NpyHeader& header) {
  if (fields.members.empty()) {
    const auto type = type_of(*fields.descr);
    if (!type || type->kind != NumberType::Kind::real)
      return {Code::invalid_argument,
              fmt::format("{}: its type {} is not float32 or float64", file,
                          quoted(*fields.descr, "(in its header)", options)),
              "save it with .astype('float64')"};
    header.type = *type;
    header.item_bytes = type->bytes;
    return {};
  }
  header.item_bytes = 0;
  for (const Member& member : fields.members) {
    auto type = type_of(member.descr);
    u128 count = 1;
    for (const std::uint64_t length : member.shape) count = count > kItemBytesMax ? count : count * length;
    if (!type || header.item_bytes + count * type->bytes > kItemBytesMax)
      return {Code::invalid_argument,
              fmt::format("{}: its field {} is of the type {}, which isn't known", file,
                          quoted(member.name, "(of its header)", options),
                          quoted(member.descr, "(in its header)", options)),
              "save the fields x, y, z and id alone: numpy.save('points.npy', a[['x', 'y', 'z', 'id']])"};
    const bool several = member.shape.size() == 1 && type->kind != NumberType::Kind::unread && count <= kMembersMax;
    const std::size_t columns = member.name.empty() ? 0 : several ? static_cast<std::size_t>(count) : 1;
    for (std::size_t c = 0; c < columns; ++c) {
      header.names.push_back(several ? fmt::format("{}:{}", member.name, c) : member.name);
      header.fields.push_back({header.item_bytes + c * type->bytes, *type});
      if (member.shape.size() > 1) header.fields.back().type.kind = NumberType::Kind::unread;
    }
    header.item_bytes += static_cast<std::size_t>(count) * type->bytes;
  }
  if (header.item_bytes > 0 && !header.fields.empty()) return {};
  return {Code::invalid_argument, file + ": its elements have no fields", "save positions as fields x, y, z"};
}

Status check_size(const InputFile& file, const NpyHeader& header) {
  u128 bytes = header.item_bytes;
  for (const std::uint64_t length : header.shape) {
    if (length == 0) bytes = 0;
  }
  for (const std::uint64_t length : header.shape) {
    // No file is as large as this product, so the check below refuses it; stopping here avoids an overflow.
    if (bytes < kBytesMax) bytes *= length;
  }
  const std::uint64_t found = file.size() - header.data_begin;
  if (bytes == found) return {};
  const std::string expected =
      bytes < kBytesMax ? fmt::format("{}", static_cast<std::uint64_t>(bytes)) : "more than any file can have";
  return Status(Code::invalid_argument,
                fmt::format("{}: its shape ({}) needs {} bytes of data, {} found", file.path(),
                            fmt::join(header.shape, ", "), expected, found),
                bytes < found ? "the file holds more than one array, or its header is wrong"
                              : "the file was cut short: copy or write it again");
}

}  // namespace

Result<NpyHeader> read_npy_header(const InputFile& file, const ReadOptions& options) {
  const auto broken = [&](const char* what) {
    return Status(Code::invalid_argument, fmt::format("{}: {}", file.path(), what), "write it again with numpy.save");
  };
  if (!file.starts_with(kNpyMagic)) return broken("is not an .npy file (its first bytes are others)");
  std::array<unsigned char, 12> head{};
  const std::size_t head_bytes = std::min<std::uint64_t>(head.size(), file.size());
  if (const Status read = file.read_at(0, head.data(), head_bytes); !read.ok()) return read;
  if (head_bytes < 10) return broken("ends inside its header");
  const unsigned version = head[6];
  if (version < 1 || version > 3 || head[7] != 0) return broken("is of an unknown .npy version");
  std::uint64_t length = head[8] | static_cast<std::uint64_t>(head[9]) << 8U;
  std::uint64_t begin = 10;
  if (version > 1) {
    if (head_bytes < 12) return broken("ends inside its header");
    length |= static_cast<std::uint64_t>(head[10]) << 16U | static_cast<std::uint64_t>(head[11]) << 24U;
    begin = 12;
  }
  if (length > file.size() - begin) return broken("ends inside its header");
  if (length > kHeaderBytesMax) return broken("has a header of more than 1 MiB");
  std::string text(static_cast<std::size_t>(length), '\0');
  if (const Status read = file.read_at(begin, text.data(), text.size()); !read.ok()) return read;

  const auto fields = Dictionary(text).read();
  if (!fields || !fields->descr || !fields->fortran_order || !fields->shape)
    return broken("has a header that can't be read");
  NpyHeader header;
  header.fortran_order = *fields->fortran_order;
  header.shape = *fields->shape;
  header.data_begin = begin + length;
  if (Status type = set_type(file.path(), *fields, options, header); !type.ok()) return type;
  const bool structured = !header.fields.empty();
  if (header.shape.empty() || header.shape.size() > (structured ? 2U : 3U)) {
    return Status(
        Code::invalid_argument,
        fmt::format("{}: its shape ({}) is not {}", file.path(), fmt::join(header.shape, ", "),
                    structured ? "(n,) or (steps, n), as it has named fields" : "(n,), (n, dims) or (steps, n, dims)"),
        "reshape it before saving");
  }
  if (const Status size = check_size(file, header); !size.ok()) return size;
  if (!structured) return header;
  if (header.fortran_order && header.shape.size() == 2)
    return Status(Code::invalid_argument, file.path() + ": a structured array of two axes in Fortran order isn't read",
                  "save it with numpy.ascontiguousarray");
  header.fortran_order = false;
  header.shape.push_back(header.fields.size());
  return header;
}

}  // namespace rcb::io
