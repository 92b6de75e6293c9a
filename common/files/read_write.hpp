// write(2) and pread(2), gone on with after a signal and until all is done.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

namespace rcb {

// Returns how many bytes it wrote; if not all, errno says why.
std::size_t write_some(int file, std::string_view bytes);
inline bool write_all(int file, std::string_view bytes) { return write_some(file, bytes) == bytes.size(); }

// A file's bytes from `offset` on, at most `bytes_max`. If fewer, errno says why; EIO where the file ended.
std::string read_some(int file, std::size_t bytes_max, std::uint64_t offset = 0);

}  // namespace rcb
