#include "common/files/read_write.hpp"

#include <cerrno>

#include <unistd.h>

namespace rcb {

std::size_t write_some(int file, std::string_view bytes) {
  std::size_t done = 0;
  while (done < bytes.size()) {
    const ssize_t count = ::write(file, bytes.data() + done, bytes.size() - done);
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) break;
    done += static_cast<std::size_t>(count);
  }
  return done;
}

std::string read_some(int file, std::size_t bytes_max, std::uint64_t offset) {
  std::string bytes(bytes_max, '\0');
  std::size_t done = 0;
  while (done < bytes_max) {
    const ssize_t count = ::pread(file, bytes.data() + done, bytes_max - done, static_cast<off_t>(offset + done));
    if (count < 0 && errno == EINTR) continue;
    if (count == 0) errno = EIO;
    if (count <= 0) break;
    done += static_cast<std::size_t>(count);
  }
  bytes.resize(done);
  return bytes;
}

}  // namespace rcb
