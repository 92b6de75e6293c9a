// What the program rcb_read_hdf5 writes to its standard output: heads, each with what it announces behind it. The first
// head tells the shape of all points, each further one a block of them; a head with a failure is the last.
#pragma once

#include <cstdint>

namespace rcb::io {

// The program, and its arguments: FILE (for messages) DATASET K OF DIMS WEIGHTS IDS BYTES_MAX FOR_CLIENT, then the
// columns of positions, if asked for. An empty DATASET: none was named, and the failure lists what there is. FOR_CLIENT
// 1: no message shows what the file holds, and no link leads to another file. The file itself is its standard input.
constexpr const char* kHdf5Program = "rcb_read_hdf5";
constexpr int kHdf5Arguments = 9;

struct Hdf5Head {
  std::uint64_t count = 0;  // points; in a block: dims arrays of float64 of so many follow, weights if any, ids if any
  std::uint32_t code = 0;   // Code of the failure; 0: none
  std::uint32_t message_bytes = 0;  // of a failure: its message and its hint follow
  std::uint32_t hint_bytes = 0;
  std::uint16_t dims = 0;
  std::uint8_t weighted = 0;
  std::uint8_t has_ids = 0;
};

constexpr std::uint32_t kHdf5TextBytesMax = 8192;  // longer texts are cut
// Deflate can't shrink data more than about 1030 times, so the bytes of a file bound what it can hold.
constexpr std::uint64_t kHdf5ShrinkMax = 1100;

}  // namespace rcb::io
