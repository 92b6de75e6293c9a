// Checks the chunks of an HDF5 dataset before the library reads them: where a chunk unpacks to fewer bytes than its
// shape needs, HDF5 1.10 doesn't notice and reads beyond the end of the data.
#pragma once

#include <array>
#include <cstdint>
#include <string>

#include <hdf5.h>

#include "common/base/status.hpp"
#include "common/io/files/input_file.hpp"

namespace rcb::hdf5 {

struct ChunkGrid {
  int axes = 1;
  std::array<hsize_t, 2> shape{0, 1};
  std::array<hsize_t, 2> chunk{1, 1};
  std::size_t type_bytes = 8;
  std::uint64_t file_bytes = 0;
};

// Checks that every chunk with rows of [begin, end) is stored and unpacks to exactly its size. Known filters: deflate,
// shuffle and fletcher32.
// Errors: invalid_argument for other filters and missing chunks, io_error for damaged ones.
Status check_chunks(const io::InputFile& file, const std::string& where, hid_t dataset, hid_t create_plist,
                    const ChunkGrid& grid, std::uint64_t begin, std::uint64_t end);

}  // namespace rcb::hdf5
