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

struct Fields {
  std::optional<std::string> descr;
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
      skip_blanks();
      // A list is a structured type: reported as such rather than as a broken header.
      if (!text_.empty() && text_[0] == '[') {
        const std::size_t end = text_.find(']');
        if (end == std::string_view::npos) return false;
        fields.descr = std::string(text_.substr(0, end + 1));
        text_.remove_prefix(end + 1);
        return true;
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

Result<NumberType> number_type(const std::string& file, const std::string& descr, const ReadOptions& options) {
  if (descr.size() == 3 && descr[1] == 'f' && (descr[2] == '4' || descr[2] == '8') &&
      std::string_view("<>=").find(descr[0]) != std::string_view::npos) {
    return NumberType{descr[2] == '4' ? std::size_t{4} : std::size_t{8}, descr[0] == '>'};
  }
  return Status(
      Code::invalid_argument,
      fmt::format("{}: its type {} is not float32 or float64", file, quoted(descr, "(in its header)", options)),
      "save it with .astype('float64')");
}

Status check_size(const InputFile& file, const NpyHeader& header) {
  u128 bytes = header.type.bytes;
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
  const auto type = number_type(file.path(), *fields->descr, options);
  if (!type.ok()) return type.status();
  NpyHeader header{*type, *fields->fortran_order, *fields->shape, begin + length};
  if (header.shape.empty() || header.shape.size() > 3) {
    return Status(Code::invalid_argument,
                  fmt::format("{}: its shape ({}) is not (n,), (n, dims) or (steps, n, dims)", file.path(),
                              fmt::join(header.shape, ", ")),
                  "reshape it before saving");
  }
  if (const Status size = check_size(file, header); !size.ok()) return size;
  return header;
}

}  // namespace rcb::io
