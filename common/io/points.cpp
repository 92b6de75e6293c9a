// Chooses the reader of a file; no exception thrown below leaves here.
#include "common/io/points.hpp"

#include <algorithm>
#include <new>

#include <fmt/format.h>

#include "common/io/files/roots.hpp"
#include "common/io/formats/fields.hpp"
#include "common/io/formats/foreign.hpp"
#include "common/io/formats/hdf5_file.hpp"
#include "common/io/formats/npy.hpp"
#include "common/io/formats/text.hpp"

namespace rcb::io {
namespace {

bool ends_with_npy(const std::string& path) { return lowered(path).ends_with(".npy"); }

// Returns the points, or reading's error; but if the file was changed meanwhile, the error that says so, whatever
// reading returned.
Result<Points> if_unchanged(const InputFile& file, Result<Points> points) {
  if (Status same = file.check_unchanged(); !same.ok()) return same;
  if (points.ok()) points->file = file.version();
  return points;
}

// The rows of arrays have numbers, not lines.
Status check_distinct(const std::string& file, const std::vector<std::int64_t>& ids) {
  const auto twice = find_duplicate(ids);
  if (!twice) return {};
  return {Code::invalid_argument,
          fmt::format("{}: row {} has the id {} of row {}", file, twice->second, ids[twice->first], twice->first),
          "give every particle an id of its own"};
}

Result<Points> read_npy(InputFile file, const ReadOptions& options, int k, int of) {
  const auto header = read_npy_header(file, options);
  if (!header.ok()) return header.status();
  if (header->shape.size() == 3 && header->shape[0] != 1) {
    return Status(Code::invalid_argument, file.path() + ": is a trajectory of shape (steps, n, dims)",
                  "use replay for it, or save one step of it");
  }
  const auto rows = NpyRows::open(std::move(file), *header, options);
  if (!rows.ok()) return rows.status();
  if (Status fits = check_bytes(rows->file().path(), u128{rows->rows()} * point_bytes(rows->columns()), options);
      !fits.ok())
    return fits;
  const std::uint64_t begin = share_begin(rows->rows(), k, of);
  Points points;
  Status read = rows->read(begin, static_cast<std::size_t>(share_begin(rows->rows(), k + 1, of) - begin), points);
  if (read.ok() && of == 1) read = check_distinct(rows->file().path(), points.id);
  return if_unchanged(rows->file(), read.ok() ? Result<Points>(std::move(points)) : read);
}

Result<InputFile> open_file(const std::string& path, const ReadOptions& options) {
  auto file = options.below == nullptr ? InputFile::open(path) : options.below->open_file(path);
  if (file.ok()) file->set_stop(options.stop);
  return file;
}

Result<Points> read_any(const std::string& path, const ReadOptions& options, int k, int of) {
  auto file = open_file(path, options);
  if (const auto hdf5 = split_hdf5_path(path); hdf5 && file.status().code() == Code::not_found) {
    file = open_file(hdf5->first, options);
    if (!file.ok()) return file.status();
    auto points = read_hdf5(*file, hdf5->second, options, k, of);
    if (Status distinct = points.ok() && of == 1 ? check_distinct(path, points->id) : Status(); !distinct.ok())
      return distinct;
    return if_unchanged(*file, std::move(points));
  }
  if (!file.ok()) return file.status();
  if (file->starts_with(kHdf5Magic)) return read_hdf5(*file, "", options, k, of);
  if (file->starts_with(kNpyMagic) || ends_with_npy(path)) return read_npy(std::move(*file), options, k, of);
  if (Status foreign = check_not_foreign(*file); !foreign.ok()) return foreign;
  if (Status fits = check_bytes(file->path(), file->size(), options); !fits.ok()) return fits;
  return if_unchanged(*file, read_text(*file, options, k, of));
}

template <typename Read>
auto without_throwing(const std::string& path, const Read& read) -> decltype(read()) {
  try {
    return read();
  } catch (const std::bad_alloc&) {
    return Status(Code::too_large, path + ": no memory for its points", "give it to more ranks or a larger machine");
  } catch (const std::exception& error) {
    return Status(Code::internal, fmt::format("{}: {}", path, error.what()));
  }
}

std::string csv_cell(std::string_view text) {
  if (text.find_first_of(",;\"\t ") == std::string_view::npos) return std::string(text);
  std::string cell = "\"";
  for (const char c : text) cell += c == '"' ? std::string("\"\"") : std::string(1, c);
  return cell + '"';
}

// The numbers of the columns that no role has.
std::vector<std::size_t> further_columns_of(const TextLayout& layout) {
  std::vector<std::size_t> further;
  const Columns& used = layout.columns;
  for (std::size_t c = 0; c < layout.column_count; ++c)
    if (std::find(used.axis.begin(), used.axis.begin() + used.dims, c) == used.axis.begin() + used.dims &&
        c != used.id && c != used.weight)
      further.push_back(c);
  return further;
}

Result<FurtherColumns> further_columns(const std::string& path, const ReadOptions& options) {
  FurtherColumns further;
  const auto file = open_file(path, options);
  if (!file.ok() && split_hdf5_path(path)) return further;
  if (!file.ok()) return file.status();
  if (file->starts_with(kHdf5Magic) || file->starts_with(kNpyMagic) || ends_with_npy(path)) return further;
  const auto layout = text_layout_of(*file, options);
  if (!layout.ok()) return layout.status();
  const std::vector<std::size_t> columns = further_columns_of(*layout);
  if (columns.empty()) return further;
  for (const std::size_t c : columns)
    further.names += ',' + csv_cell(c < layout->names.size() && !layout->names[c].empty() ? layout->names[c]
                                                                                          : fmt::format("column{}", c));
  further.begin.push_back(0);
  const Status read = visit_fields(*file, *layout, [&](const std::vector<std::string_view>& fields) {
    for (const std::size_t c : columns) further.text += ',' + (c < fields.size() ? csv_cell(fields[c]) : "");
    further.begin.push_back(further.text.size());
  });
  if (!read.ok()) return read;
  return further;
}

class NpyTrajectory final : public TrajectoryReader {
 public:
  NpyTrajectory(NpyRows rows, const NpyHeader& header)
      : rows_(std::move(rows)), steps_(header.shape[0]), n_(header.shape[1]) {}
  int dims() const override { return rows_.columns().dims; }
  std::uint64_t frames() const override { return steps_; }
  Result<Points> frame(std::uint64_t k) override {
    return without_throwing("a frame", [&]() -> Result<Points> {
      if (k >= steps_) return Status(Code::not_found, fmt::format("frame {} of {}", k, steps_));
      Points points;
      Status read = rows_.read(k * n_, static_cast<std::size_t>(n_), points);
      if (read.ok()) read = check_distinct(fmt::format("{}: frame {}", rows_.file().path(), k), points.id);
      if (!read.ok()) return read;
      return points;
    });
  }

 private:
  NpyRows rows_;
  std::uint64_t steps_;
  std::uint64_t n_;
};

class OneFrame final : public TrajectoryReader {
 public:
  explicit OneFrame(Points points) : points_(std::move(points)) {}
  int dims() const override { return points_.dims; }
  std::uint64_t frames() const override { return 1; }
  Result<Points> frame(std::uint64_t k) override {
    if (k > 0) return Status(Code::not_found, fmt::format("frame {} of 1", k));
    return without_throwing("a frame", [&]() -> Result<Points> { return points_; });
  }

 private:
  Points points_;
};

Result<std::unique_ptr<TrajectoryReader>> open_any(const std::string& path, const ReadOptions& options) {
  auto file = open_file(path, options);
  if (file.ok() && (file->starts_with(kNpyMagic) || ends_with_npy(path))) {
    const auto header = read_npy_header(*file, options);
    if (!header.ok()) return header.status();
    if (header->shape.size() == 3) {
      constexpr std::uint64_t kEmptyFramesMax = 1U << 20U;  // frames without particles take no bytes of the file
      if (header->shape[1] == 0 && header->shape[0] > kEmptyFramesMax) {
        return Status(Code::invalid_argument, fmt::format("{}: {} frames without particles", path, header->shape[0]));
      }
      auto rows = NpyRows::open(std::move(*file), *header, options);
      if (!rows.ok()) return rows.status();
      if (const Status checked = rows->check(); !checked.ok()) return checked;
      return std::unique_ptr<TrajectoryReader>(std::make_unique<NpyTrajectory>(std::move(*rows), *header));
    }
  }
  auto points = read_any(path, options, 0, 1);
  if (!points.ok()) return points.status();
  return std::unique_ptr<TrajectoryReader>(std::make_unique<OneFrame>(std::move(*points)));
}

}  // namespace

Result<FurtherColumns> read_further_columns(const std::string& path, const ReadOptions& options) {
  return without_throwing(path, [&]() { return further_columns(path, options); });
}

Result<Points> read_points_slice(const std::string& path, const ReadOptions& options, int k, int of) {
  CHECK(of >= 1 && k >= 0 && k < of, "share k of `of`");
  return without_throwing(path, [&]() { return read_any(path, options, k, of); });
}

Result<std::unique_ptr<TrajectoryReader>> open_trajectory(const std::string& path, const ReadOptions& options) {
  return without_throwing(path, [&]() { return open_any(path, options); });
}

}  // namespace rcb::io
