#include "common/io/formats/lines.hpp"

#include <algorithm>

#include <fmt/format.h>

#include "common/io/formats/fields.hpp"

namespace rcb::io {
namespace {

constexpr std::size_t kReadBytes = std::size_t{256} << 10U;
constexpr std::size_t kLineBytesMax = std::size_t{1} << 20U;

// The bytes of the first `count` lines of the text, or of those that are whole.
struct Whole {
  std::size_t bytes = 0;
  std::uint64_t lines = 0;
};

Whole whole_lines(std::string_view text, std::uint64_t count) {
  Whole found;
  while (found.lines < count) {
    const std::size_t end = text.find('\n', found.bytes);
    if (end == std::string_view::npos) break;
    found.bytes = end + 1;
    ++found.lines;
  }
  return found;
}

}  // namespace

Result<bool> LineReader::fill() {
  if (ended_) return false;
  if (begin_ > 0) {
    buffer_.erase(0, begin_);
    end_ -= begin_;
    begin_ = 0;
  }
  if (buffer_.size() < end_ + kReadBytes) buffer_.resize(end_ + kReadBytes);
  const auto got = source_.bytes->read(buffer_.data() + end_, kReadBytes);
  if (!got) return got.status();
  end_ += *got;
  ended_ = *got == 0;
  if (!begun_ && (ended_ || end_ >= kByteOrderMark.size())) {
    begun_ = true;
    if (held().starts_with(kByteOrderMark)) begin_ = kByteOrderMark.size();
  }
  return !ended_;
}

Result<std::string_view> LineReader::next(std::uint64_t count, LastLine last) {
  for (;;) {
    const Whole whole = begun_ ? whole_lines(held(), count) : Whole{};
    if (whole.lines > 0) {
      const std::string_view taken = held().substr(0, whole.bytes);
      begin_ += whole.bytes;
      line_ += whole.lines;
      return taken;
    }
    if (ended_) {
      const std::string_view taken = last == LastLine::may_lack_its_end ? held() : std::string_view();
      begin_ += taken.size();
      line_ += taken.empty() ? 0U : 1U;
      return taken;
    }
    if (end_ - begin_ > kLineBytesMax)
      return Status(Code::too_large, fmt::format("{}:{}: a line of more than {} bytes", name(), line_, kLineBytesMax),
                    "is this a text file of points?");
    if (const auto more = fill(); !more) return more.status();
  }
}

Result<std::string_view> LineReader::peek(int count) {
  for (;;) {
    const Whole whole = begun_ ? whole_lines(held(), static_cast<std::uint64_t>(count)) : Whole{};
    if (whole.lines == static_cast<std::uint64_t>(count)) return held().substr(0, whole.bytes);
    if (ended_ || end_ - begin_ - whole.bytes > kLineBytesMax) return held();
    if (const auto more = fill(); !more) return more.status();
  }
}

Result<std::string_view> LineReader::bytes() {
  while (begin_ == end_ && !ended_)
    if (const auto more = fill(); !more) return more.status();
  const std::string_view taken = held();
  begin_ = end_;
  return taken;
}

}  // namespace rcb::io
