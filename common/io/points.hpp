// Readers and writers of point files: CSV/text, XYZ, .npy, HDF5. A bad file is refused with its name, the line or
// index, and the reason.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.hpp"
#include "common/io/files/output_file.hpp"
#include "common/io/formats/columns.hpp"
#include "common/io/formats/frames.hpp"

namespace rcb::io {

// Reads share k of `of` of the rows of a file, in order: rows for .npy and HDF5, whole lines by byte range for text.
// Ids by row are NOT filled in (only the caller knows how many rows precede); the caller must find duplicates across
// slices. path: an .npy file (recognised by its name or first bytes; also a trajectory of one step), FILE.h5:/dataset,
// else text, which is taken for XYZ if it begins with a count line (a LAMMPS dump, and what gzip has
// compressed, is for open_trajectory alone: it has no slices). Columns named x, y, z, id (in any case; also
// Points:0 and so on, as ParaView writes them) are taken by name, and other names are refused unless the options say
// which columns to take; without names the first `dims` columns that are neither id nor weights (docs/files.md). An
// empty text file has no points, in `dims` dimensions or 3. Only regular files. NaN, infinity, duplicate or negative
// ids and ragged rows are refused: "points.csv:17: ...".
Result<Points> read_points_slice(const std::string& path, const ReadOptions& options, int k, int of);

// The columns of a text file that are neither positions nor ids nor weights, as CSV.
struct FurtherColumns {
  std::string names;               // ",vx,mass"; empty: there are none
  std::string text;                // ",0.5,3" of every row, one behind the other
  std::vector<std::size_t> begin;  // of each row in `text`, and its end

  std::size_t rows() const { return begin.empty() ? 0 : begin.size() - 1; }
  std::string_view row(std::size_t k) const { return std::string_view(text).substr(begin[k], begin[k + 1] - begin[k]); }
};
// Of a file that isn't plain text, of a LAMMPS dump, and of what can be read only once: none. Errors: those of reading
// it.
Result<FurtherColumns> read_further_columns(const std::string& path, const ReadOptions& options);

// Writes, piece by piece, the columns x, y, z, id, weight (id and weight only if given), with as few digits as read
// back to the same number.
class CsvWriter {
 public:
  // further: the names of further columns, as in FurtherColumns.
  CsvWriter(OutputFile file, int dims, bool ids, bool weights, const std::string& further = {});
  // id, weight: as many as `count` if the file has them. further: likewise, the text of each row's further columns.
  Status append(std::span<const double* const> position, std::size_t count, std::span<const std::int64_t> id,
                std::span<const double> weight, std::span<const std::string_view> further = {});
  Status commit();

 private:
  Status flush();

  OutputFile file_;
  int dims_;
  bool ids_;
  bool weights_;
  std::string text_;  // not written yet
};

// .npy files, version 1.0, C order, little-endian.
Status write_npy(const std::string& path, std::span<const std::int32_t> values);
Status write_npy(const std::string& path, std::span<const std::int64_t> values);
Status write_npy(const std::string& path, std::span<const double> values, std::vector<std::uint64_t> shape);

// Opens a trajectory to read it frame by frame: an .npy file of shape (steps, n, dims), a LAMMPS dump, an XYZ file; any
// other point file is one frame. path "-": standard input; that and FIFOs are read as they come, and what isn't frames
// of text only once it has ended. Text may be compressed by gzip. An .npy file is checked as a whole (size, finite
// values) before this returns.
Result<std::unique_ptr<TrajectoryReader>> open_trajectory(const std::string& path, const ReadOptions& options);
// The same for a trajectory of that format alone; none: by its first lines. Nothing is read yet where one is given.
Result<std::unique_ptr<TrajectoryReader>> open_frames(const std::string& path, const ReadOptions& options,
                                                      std::optional<FrameFormat> format);

// Writes (steps, n, dims) float64 as the frames come; the header is completed by close(). The file appears under its
// name at close() (written beside it, then renamed).
class TrajectoryWriter {
 public:
  static Result<std::unique_ptr<TrajectoryWriter>> create(const std::string& path, std::uint64_t count, int dims);
  virtual ~TrajectoryWriter() = default;
  virtual Status append(std::span<const double> positions) = 0;  // [count * dims], C order
  virtual Status close() = 0;
};

}  // namespace rcb::io
