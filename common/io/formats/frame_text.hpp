// What the readers of frames of text share: the rows of a frame, and a text that ends within one.
#pragma once

#include <cstdint>
#include <string>

#include "common/io/formats/frames.hpp"
#include "common/io/formats/text.hpp"

namespace rcb::io {

class FrameText : public TrajectoryReader {
 public:
  FrameText(LineReader lines, ReadOptions options) : lines_(std::move(lines)), options_(std::move(options)) {}

  std::optional<std::uint64_t> frames() const override { return std::nullopt; }
  Result<std::optional<Points>> next() override;
  std::string unfinished() const override { return unfinished_; }

 protected:
  struct Begun {
    std::uint64_t line = 1;                // where the frame begins
    std::string which;                     // "frame 3" or "frame 3 (timestep 1000)"
    std::optional<std::uint64_t> count{};  // of its rows, once it is known
  };

  // Reads a frame, of which there is a line at least. None: the text ends within it.
  virtual Result<std::optional<Points>> read_frame() = 0;
  // What gives the rows their columns, for messages: "ITEM: ATOMS names".
  virtual const char* columns_from() const = 0;

  // None: the text ends before the last row.
  Result<std::optional<Points>> read_rows(const TextLayout& layout, std::uint64_t count, LastLine last);
  // The next line without its end and blanks around it; none: the text ends.
  Result<std::optional<std::string>> next_line(LastLine last = LastLine::must_end);
  Status fault(std::uint64_t line, const std::string& what, const std::string& hint) const;

  LineReader lines_;
  ReadOptions options_;
  std::uint64_t number_ = 0;  // of the frame being read
  Begun begun_;

 private:
  Status row_refused(std::uint64_t line, std::string_view row, const TextLayout& layout, std::uint64_t rows) const;
  Status check_ids(const Points& points) const;

  std::uint64_t rows_read_ = 0;  // of the frame being read
  std::string unfinished_;
};

}  // namespace rcb::io
