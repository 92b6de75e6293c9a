// Trajectories frame by frame. Those of text are read as they come: LAMMPS' dumps (`dump atom`, `dump custom`) and XYZ
// files of one frame or many.
//
// Invariants
// 1. At most one frame is in memory, and of a frame only the rows that have come, whatever its count claims.
// 2. A frame is given only when it is whole.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "common/base/status.hpp"
#include "common/io/formats/columns.hpp"
#include "common/io/formats/lines.hpp"

namespace rcb::io {

class TrajectoryReader {
 public:
  virtual ~TrajectoryReader() = default;
  // How many frames there are; none: that turns out at the end.
  virtual std::optional<std::uint64_t> frames() const = 0;
  // The next frame, none at the end. Ids only if the file has them. Errors name file and line or frame; also
  // invalid_argument, if a stream ends within a frame.
  virtual Result<std::optional<Points>> next() = 0;
  // After the end of a file: where it ends within a frame, which may still be being written; else empty.
  virtual std::string unfinished() const { return {}; }
};

enum class FrameFormat { lammps, xyz };

// What the text is by its first lines; none: something else. Waits for three lines, or the end.
Result<std::optional<FrameFormat>> frame_format(LineReader& lines, const ReadOptions& options);

std::unique_ptr<TrajectoryReader> read_lammps(LineReader lines, const ReadOptions& options);
std::unique_ptr<TrajectoryReader> read_xyz(LineReader lines, const ReadOptions& options);

}  // namespace rcb::io
