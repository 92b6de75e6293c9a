// A dataset of an HDF5 file: FILE.h5:/path, float32 or float64, shape (n, dims) or (n,). Serial C interface.
#pragma once

#include <optional>
#include <string>
#include <utility>

#include "common/base/status.hpp"
#include "common/io/input_file.hpp"
#include "common/io/points.hpp"

namespace rcb::io {

constexpr std::string_view kHdf5Magic = "\x89HDF\r\n\x1a\n";

// FILE and /path of "FILE:/path".
std::optional<std::pair<std::string, std::string>> split_hdf5_path(const std::string& path);

// Share k of `of` of the dataset's rows.
Result<Points> read_hdf5(const InputFile& file, const std::string& dataset, const ReadOptions& options, int k, int of);

// An HDF5 file that was named without a dataset: which it has.
Status hdf5_needs_path(const InputFile& file, const ReadOptions& options);

}  // namespace rcb::io
