// Readers and writers of point files: CSV/text, XYZ, .npy, HDF5. A bad file is refused with its name, the line or
// index, and the reason.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/io/input_file.hpp"
#include "common/io/output_file.hpp"

namespace rcb::io {

class Roots;

struct ReadOptions {
  int dims = 0;         // 1..3; 0: columns named x, y, z, else all columns but the weights one (more than 3: refused,
                        // with the advice --dims)
  std::string weights;  // a column's name, or its number from 0; empty: none
  // On somebody else's word: only files below these, and no message shows what a file holds. Null: as this process may.
  const Roots* below = nullptr;
};

struct Points {
  int dims = 0;
  std::size_t count = 0;
  std::vector<std::vector<double>> position;  // [dims][count]
  std::vector<std::int64_t> id;               // [count]; empty: ids by row
  std::vector<double> weight;                 // [count] or empty
  FileVersion file;                           // slices of one set are of one file, in one state
};

// The whole file. path: an .npy file (by its name or first bytes; a trajectory of one step too), FILE.h5:/dataset,
// else text, which is taken for XYZ by its count line. Columns named x, y, z, id (any case; Points:0 and so on, as
// ParaView writes them, too) are taken by name; without x, y, z the first `dims` columns beside id and weights. An
// empty text file has no points, in `dims` dimensions or 3. Only regular files. NaN, infinity, duplicate or negative
// ids, ragged rows are refused: "points.csv:17: ...".
Result<Points> read_points(const std::string& path, const ReadOptions& options);

// Share k of `of` of the same rows, in order: rows of the file for .npy and HDF5, whole lines by byte range for text.
// Ids by row are NOT filled in (the caller knows the rows before); duplicates across slices are the caller's to find.
Result<Points> read_points_slice(const std::string& path, const ReadOptions& options, int k, int of);

// Writes "x,y,z,id,weight" columns (those that are there; ids given) with 17 significant digits, or shortest
// round-trip.
Status write_csv(const std::string& path, int dims, std::span<const double* const> position, std::size_t count,
                 const std::int64_t* id, const double* weight);
Status write_csv(OutputFile file, int dims, std::span<const double* const> position, std::size_t count,
                 const std::int64_t* id, const double* weight);

// .npy files, version 1.0, C order, little-endian.
Status write_npy(const std::string& path, std::span<const std::int32_t> values);
Status write_npy(const std::string& path, std::span<const std::int64_t> values);
Status write_npy(const std::string& path, std::span<const double> values, std::vector<std::uint64_t> shape);

// Reads a trajectory frame by frame: .npy of shape (steps, n, dims), or one point file = one frame.
class TrajectoryReader {
 public:
  virtual ~TrajectoryReader() = default;
  virtual int dims() const = 0;
  virtual std::uint64_t frames() const = 0;
  // Frame k as Points without ids beyond the file's own. Errors name file and frame.
  virtual Result<Points> frame(std::uint64_t k) = 0;
};
// Opens and checks: an .npy is checked whole (size, finite values) before this returns.
Result<std::unique_ptr<TrajectoryReader>> open_trajectory(const std::string& path, const ReadOptions& options);

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
