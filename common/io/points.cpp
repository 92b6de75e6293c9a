// Chooses the reader of a file; no exception thrown below leaves here.
#include "common/io/points.hpp"

#include <algorithm>

#include <fmt/format.h>

#include "common/io/files/byte_source.hpp"
#include "common/io/files/roots.hpp"
#include "common/io/formats/fields.hpp"
#include "common/io/formats/foreign.hpp"
#include "common/io/formats/hdf5_file.hpp"
#include "common/io/formats/npy.hpp"
#include "common/io/formats/text.hpp"
#include "common/io/slices.hpp"

namespace rcb::io {
namespace {

// Returns the points, or reading's error; but if the file was changed meanwhile, the error that says so, whatever
// reading returned.
Result<Points> if_unchanged(const InputFile& file, Result<Points> points) {
  if (Status same = file.check_unchanged(); !same.ok()) return same;
  if (points.ok()) points->file = file.version();
  return points;
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

// Formats that are read from their beginning to their end.
Status check_sliceable(const InputFile& file) {
  const bool packed = file.starts_with(kGzipMagic);
  if (!packed && !file.starts_with("ITEM: ")) return {};
  return {Code::invalid_argument,
          fmt::format("{}: is {}, which isn't read in slices", file.path(),
                      packed ? "compressed by gzip" : "a LAMMPS dump"),
          "let rcbctl read it and push it: rcbctl push, replay"};
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
  if (is_stream(path)) return further;
  const auto file = open_file(path, options);
  if (!file.ok() && split_hdf5_path(path)) return further;
  if (!file.ok()) return file.status();
  if (file->starts_with(kHdf5Magic) || file->starts_with(kNpyMagic) || ends_with_npy(path)) return further;
  if (!check_sliceable(*file).ok()) return further;
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

}  // namespace

Status check_distinct(const std::string& file, const std::vector<std::int64_t>& ids) {
  const auto twice = find_duplicate(ids);
  if (!twice) return {};
  return {Code::invalid_argument,
          fmt::format("{}: row {} has the id {} of row {}", file, twice->second, ids[twice->first], twice->first),
          "give every particle an id of its own"};
}

Result<InputFile> open_file(const std::string& path, const ReadOptions& options) {
  auto file = options.below == nullptr ? InputFile::open(path) : options.below->open_file(path);
  if (file.ok()) file->set_stop(options.stop);
  return file;
}

Result<Points> read_slice(InputFile file, const ReadOptions& options, int k, int of) {
  if (file.starts_with(kHdf5Magic)) return read_hdf5(file, "", options, k, of);
  if (file.starts_with(kNpyMagic) || ends_with_npy(file.path())) return read_npy(std::move(file), options, k, of);
  if (Status status = check_sliceable(file); !status.ok()) return status;
  if (Status foreign = check_not_foreign(file); !foreign.ok()) return foreign;
  if (Status fits = check_bytes(file.path(), file.size(), options); !fits.ok()) return fits;
  return if_unchanged(file, read_text(file, options, k, of));
}

Result<Points> read_slice(const std::string& path, const ReadOptions& options, int k, int of) {
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
  return read_slice(std::move(*file), options, k, of);
}

Result<FurtherColumns> read_further_columns(const std::string& path, const ReadOptions& options) {
  return without_throwing(path, [&]() { return further_columns(path, options); });
}

Result<Points> read_points_slice(const std::string& path, const ReadOptions& options, int k, int of) {
  RCB_CHECK(of >= 1 && k >= 0 && k < of, "share k of `of`");
  return without_throwing(path, [&]() { return read_slice(path, options, k, of); });
}

}  // namespace rcb::io
