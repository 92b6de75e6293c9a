// Reads datasets of HDF5 files: FILE.h5:/path, float32 or float64, shape (n, dims) or (n,). Serial C interface.
//
// libhdf5 trusts the files that it reads: a damaged one can make it write beyond its memory. So this is linked only
// into a program of its own, rcb_read_hdf5, which others start and whose death costs nothing
// (common/io/formats/hdf5_file).
#pragma once

#include <functional>
#include <string>

#include "common/base/status.hpp"
#include "common/io/files/input_file.hpp"
#include "common/io/formats/columns.hpp"

namespace rcb::hdf5 {

// Takes all points' dims and number, without arrays, then blocks of them in order. An error ends the reading.
using Sink = std::function<Status(const io::Points& points)>;

// Reads share k of `of` of the dataset's rows. An empty name: the error lists what the file has.
Status read(const io::InputFile& file, const std::string& dataset, const io::ReadOptions& options, int k, int of,
            const Sink& sink);

}  // namespace rcb::hdf5
