// A dataset of an HDF5 file: FILE.h5:/path. A program of its own reads it (common/hdf5), since libhdf5 can be made to
// destroy the memory of the process that it runs in.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "common/base/status.hpp"
#include "common/io/files/input_file.hpp"
#include "common/io/formats/columns.hpp"

namespace rcb::io {

constexpr std::string_view kHdf5Magic = "\x89HDF\r\n\x1a\n";

// FILE and /path of "FILE:/path".
std::optional<std::pair<std::string, std::string>> split_hdf5_path(const std::string& path);

// Reads share k of `of` of the dataset's rows. An empty dataset: the error lists the datasets of the file.
// Errors: those of the file; io_error where it is damaged; unsupported where the reading program isn't installed;
// deadline_exceeded if that says nothing for ten minutes.
Result<Points> read_hdf5(const InputFile& file, const std::string& dataset, const ReadOptions& options, int k, int of);

}  // namespace rcb::io
