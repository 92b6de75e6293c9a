// Opens what has frames, in whatever format; no exception thrown below leaves here.
#include <cerrno>
#include <cstring>
#include <utility>

#include <fmt/format.h>
#include <sys/mman.h>
#include <unistd.h>

#include "common/files/descriptor.hpp"
#include "common/io/files/byte_source.hpp"
#include "common/io/formats/hdf5_file.hpp"
#include "common/io/formats/npy.hpp"
#include "common/io/points.hpp"
#include "common/io/slices.hpp"

namespace rcb::io {
namespace {

class NpyTrajectory final : public TrajectoryReader {
 public:
  NpyTrajectory(NpyRows rows, const NpyHeader& header)
      : rows_(std::move(rows)), steps_(header.shape[0]), n_(header.shape[1]) {}
  std::optional<std::uint64_t> frames() const override { return steps_; }
  Result<std::optional<Points>> next() override {
    if (next_ == steps_) return std::optional<Points>();
    Points points;
    Status read = rows_.read(next_ * n_, static_cast<std::size_t>(n_), points);
    if (read.ok()) read = check_distinct(fmt::format("{}: frame {}", rows_.file().path(), next_), points.id);
    if (!read.ok()) return read;
    ++next_;
    return std::optional(std::move(points));
  }

 private:
  NpyRows rows_;
  std::uint64_t steps_;
  std::uint64_t n_;
  std::uint64_t next_ = 0;
};

class OneFrame final : public TrajectoryReader {
 public:
  explicit OneFrame(Points points) : points_(std::move(points)) {}
  std::optional<std::uint64_t> frames() const override { return 1; }
  Result<std::optional<Points>> next() override { return std::exchange(points_, std::nullopt); }

 private:
  std::optional<Points> points_;
};

// A reader whose first frame has been read already.
class FirstRead final : public TrajectoryReader {
 public:
  FirstRead(Points first, std::unique_ptr<TrajectoryReader> rest) : first_(std::move(first)), rest_(std::move(rest)) {}
  std::optional<std::uint64_t> frames() const override { return std::nullopt; }
  Result<std::optional<Points>> next() override {
    if (first_) return std::exchange(first_, std::nullopt);
    return rest_->next();
  }
  std::string unfinished() const override { return first_ ? std::string() : rest_->unfinished(); }

 private:
  std::optional<Points> first_;
  std::unique_ptr<TrajectoryReader> rest_;
};

using Opened = Result<std::unique_ptr<TrajectoryReader>>;

Opened one_frame(Result<Points> points) {
  if (!points.ok()) return points.status();
  return std::unique_ptr<TrajectoryReader>(std::make_unique<OneFrame>(std::move(*points)));
}

// Any format but a text of frames.
Opened open_other(InputFile file, const ReadOptions& options) {
  if (!file.starts_with(kNpyMagic) && !ends_with_npy(file.path()))
    return one_frame(read_slice(std::move(file), options, 0, 1));
  const auto header = read_npy_header(file, options);
  if (!header.ok()) return header.status();
  if (header->shape.size() != 3) return one_frame(read_slice(std::move(file), options, 0, 1));
  constexpr std::uint64_t kEmptyFramesMax = 1U << 20U;  // frames without particles take no bytes of the file
  if (header->shape[1] == 0 && header->shape[0] > kEmptyFramesMax)
    return Status(Code::invalid_argument,
                  fmt::format("{}: {} frames without particles", file.path(), header->shape[0]));
  auto rows = NpyRows::open(std::move(file), *header, options);
  if (!rows.ok()) return rows.status();
  if (const Status checked = rows->check(); !checked.ok()) return checked;
  return std::unique_ptr<TrajectoryReader>(std::make_unique<NpyTrajectory>(std::move(*rows), *header));
}

// A copy, in memory, of what is left of a text that can be read only once.
Result<InputFile> copied(LineReader& lines) {
  Descriptor memory(::memfd_create("rcbd points", MFD_CLOEXEC));
  for (;;) {
    const auto bytes = lines.bytes();
    if (!bytes.ok()) return bytes.status();
    if (bytes->empty()) break;
    for (std::size_t at = 0; at < bytes->size();) {
      const ssize_t written = ::write(memory.get(), bytes->data() + at, bytes->size() - at);
      if (written < 0 && errno == EINTR) continue;
      if (written < 0)
        return Status(Code::too_large, fmt::format("{}: no memory for it: {}", lines.name(), std::strerror(errno)),
                      "write it to a file first");
      at += static_cast<std::size_t>(written);
    }
  }
  return InputFile::take(std::move(memory), lines.name());
}

std::unique_ptr<TrajectoryReader> frames_of(FrameFormat format, LineReader lines, const ReadOptions& options) {
  return format == FrameFormat::lammps ? read_lammps(std::move(lines), options) : read_xyz(std::move(lines), options);
}

Opened open_text(const std::string& path, const ReadOptions& options) {
  auto opened = open_bytes(path, {options.stop, options.on_wait});
  if (!opened.ok()) return opened.status();
  const bool again = !opened->is_stream && !opened->packed && path != kStandardInput;  // it can be read once more
  LineReader lines(std::move(*opened));
  const auto format = frame_format(lines, options);
  if (!format.ok()) return format.status();
  if (!*format && again) return one_frame(read_slice(path, options, 0, 1));
  if (!*format) {
    auto file = copied(lines);
    return file.ok() ? open_other(std::move(*file), options) : file.status();
  }
  auto reader = frames_of(**format, std::move(lines), options);
  if (**format != FrameFormat::xyz || !again) return reader;
  auto first = reader->next();
  // What is wrong with a file of a single frame is said as of any text.
  if (!first.ok() || !*first) return one_frame(read_slice(path, options, 0, 1));
  return std::unique_ptr<TrajectoryReader>(std::make_unique<FirstRead>(std::move(**first), std::move(reader)));
}

Opened open_any(const std::string& path, const ReadOptions& options) {
  if (is_stream(path)) return open_text(path, options);
  auto file = open_file(path, options);
  if (!file.ok() || file->starts_with(kHdf5Magic)) return one_frame(read_slice(path, options, 0, 1));
  if (file->starts_with(kNpyMagic) || ends_with_npy(path)) return open_other(std::move(*file), options);
  return open_text(path, options);
}

Opened open_any_frames(const std::string& path, const ReadOptions& options, std::optional<FrameFormat> format) {
  auto opened = open_bytes(path, {options.stop, options.on_wait});
  if (!opened.ok()) return opened.status();
  LineReader lines(std::move(*opened));
  if (!format) {
    const auto found = frame_format(lines, options);
    if (!found.ok()) return found.status();
    if (!*found)
      return Status(Code::invalid_argument, lines.name() + ": is neither a LAMMPS dump nor an XYZ file",
                    "rcbctl push and replay take other formats");
    format = **found;
  }
  return frames_of(*format, std::move(lines), options);
}

// Faults that are thrown while frames are read become errors.
class Guarded final : public TrajectoryReader {
 public:
  Guarded(std::string path, std::unique_ptr<TrajectoryReader> reader)
      : path_(std::move(path)), reader_(std::move(reader)) {}
  std::optional<std::uint64_t> frames() const override { return reader_->frames(); }
  Result<std::optional<Points>> next() override {
    return without_throwing(path_, [this] { return reader_->next(); });
  }
  std::string unfinished() const override { return reader_->unfinished(); }

 private:
  std::string path_;
  std::unique_ptr<TrajectoryReader> reader_;
};

Opened guarded(const std::string& path, Opened opened) {
  if (!opened.ok()) return opened;
  return std::unique_ptr<TrajectoryReader>(std::make_unique<Guarded>(path, std::move(*opened)));
}

}  // namespace

Opened open_trajectory(const std::string& path, const ReadOptions& options) {
  return guarded(path, without_throwing(path, [&]() { return open_any(path, options); }));
}

Opened open_frames(const std::string& path, const ReadOptions& options, std::optional<FrameFormat> format) {
  return guarded(path, without_throwing(path, [&]() { return open_any_frames(path, options, format); }));
}

}  // namespace rcb::io
