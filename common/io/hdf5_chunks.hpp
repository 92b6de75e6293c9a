// Chunks of an HDF5 dataset, checked before the library reads them: HDF5 1.10 takes a chunk that unpacks to fewer
// bytes than its claimed shape needs as if they were there, and reads on behind them.
#pragma once

#include <array>
#include <cstdint>
#include <string>

#include <hdf5.h>

#include "common/base/status.hpp"

namespace rcb::io {

struct ChunkGrid {
  int axes = 1;
  std::array<hsize_t, 2> shape{0, 1};
  std::array<hsize_t, 2> chunk{1, 1};
  std::size_t type_bytes = 8;
  std::uint64_t file_bytes = 0;
};

// That every chunk with rows [begin, end) is stored and unpacks to just its size. filters: deflate, shuffle and
// fletcher32 are known.
// Errors: invalid_argument for other filters and missing chunks, io_error for damaged ones.
Status check_chunks(const std::string& where, hid_t dataset, hid_t create_plist, const ChunkGrid& grid,
                    std::uint64_t begin, std::uint64_t end);

}  // namespace rcb::io
