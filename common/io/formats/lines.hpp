// LineReader: a text line by line, in a bounded piece of memory, as its bytes come.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

#include "common/base/status.hpp"
#include "common/io/files/byte_source.hpp"

namespace rcb::io {

// Whether the text's last line counts where it lacks its end: it may still be being written.
enum class LastLine { must_end, may_lack_its_end };

class LineReader {
 public:
  explicit LineReader(OpenedBytes source) : source_(std::move(source)) {}

  const std::string& name() const { return source_.name; }
  const OpenedBytes& source() const { return source_; }
  // The number of the next line, from 1.
  std::uint64_t line() const { return line_; }

  // Takes the next lines with their ends: as many as have come already, but at least one and at most `count` (> 0).
  // Empty: no whole line is left. Valid until the next call. Errors: those of the source; too_large for a line.
  Result<std::string_view> next(std::uint64_t count, LastLine last = LastLine::must_end);
  // The next `count` lines, which are not taken; fewer only at the end of the text, the last perhaps without its end.
  Result<std::string_view> peek(int count);
  // Takes some more of the text, whatever its lines; empty at the end. Valid until the next call.
  Result<std::string_view> bytes();

 private:
  std::string_view held() const { return std::string_view(buffer_).substr(begin_, end_ - begin_); }
  // Reads more bytes; false at the end of the text.
  Result<bool> fill();

  OpenedBytes source_;
  std::string buffer_;  // bytes [begin_, end_) are not taken yet
  std::size_t begin_ = 0;
  std::size_t end_ = 0;
  std::uint64_t line_ = 1;
  bool ended_ = false;
  bool begun_ = false;
};

}  // namespace rcb::io
