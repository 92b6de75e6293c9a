// XYZ files of one frame or many: a line with the number of rows, a comment, the rows; then the next frame. What the
// columns are, text_layout says of each frame by its first three lines.
#include <fmt/format.h>

#include "common/io/formats/fields.hpp"
#include "common/io/formats/frame_text.hpp"

namespace rcb::io {
namespace {

class XyzFrames final : public FrameText {
 public:
  using FrameText::FrameText;

 private:
  const char* columns_from() const override { return "the frame's first row has"; }

  Result<std::optional<Points>> read_frame() override {
    // As files that people wrote may lack the end of their last line, but frames behind others may be cut there.
    const LastLine last = number_ == 0 ? LastLine::may_lack_its_end : LastLine::must_end;
    const auto first = next_line(last);
    if (!first) return first.status();
    if (!*first) return std::optional<Points>();
    const auto count = lone_count(**first);
    if (!count) return no_count(**first);
    begun_.count = count;
    const auto comment = next_line(last);
    if (!comment) return comment.status();
    if (*count == 0) {
      Points none;
      none.dims = dims_;
      none.position.resize(static_cast<std::size_t>(dims_));
      return std::optional(std::move(none));
    }
    const auto row = lines_.peek(1);
    if (!row) return row.status();
    if (!*comment || row->empty() || (last == LastLine::must_end && !row->ends_with('\n')))
      return std::optional<Points>();
    const std::string head = fmt::format("{}\n{}\n{}", **first, **comment, *row);
    const auto layout = text_layout(lines_.name(), head, true, options_);
    RCB_CHECK(layout, "the whole of a text always has a layout");
    if (!*layout) return at_its_line(layout->status());
    if (!(*layout)->row_count)
      return fault(begun_.line + 2, "its rows have a single column", "take another format than xyz for it");
    dims_ = (*layout)->columns.dims;
    last_count_ = *count;
    return read_rows(**layout, *count, last);
  }

  // What text_layout says of line 2 is about this frame's comment.
  Status at_its_line(const Status& status) const {
    const std::string second = lines_.name() + ":2:";
    if (!status.message().starts_with(second)) return status;
    return {status.code(),
            fmt::format("{}:{}:{}", lines_.name(), begun_.line + 1, status.message().substr(second.size())),
            status.hint()};
  }

  Status no_count(const std::string& text) const {
    if (number_ == 0)
      return fault(begun_.line, fmt::format("'{}' where the number of rows should stand", shown(text)),
                   "is it an XYZ file?");
    return fault(begun_.line,
                 fmt::format("'{}' where the next frame's number of rows should stand; the frame before has {}",
                             shown(text), last_count_),
                 "is that number right?");
  }

  int dims_ = options_.dims == 0 ? 3 : options_.dims;
  std::uint64_t last_count_ = 0;
};

}  // namespace

std::unique_ptr<TrajectoryReader> read_xyz(LineReader lines, const ReadOptions& options) {
  return std::make_unique<XyzFrames>(std::move(lines), options);
}

Result<std::optional<FrameFormat>> frame_format(LineReader& lines, const ReadOptions& options) {
  const auto line = lines.peek(1);
  if (!line) return line.status();
  if (line->starts_with("ITEM:")) return std::optional(FrameFormat::lammps);
  if (!lone_count(trimmed(line->substr(0, line->find('\n'))))) return std::optional<FrameFormat>();
  const auto head = lines.peek(3);
  if (!head) return head.status();
  const auto layout = text_layout(lines.name(), *head, true, options);
  return layout && layout->ok() && (*layout)->row_count ? std::optional(FrameFormat::xyz) : std::nullopt;
}

}  // namespace rcb::io
