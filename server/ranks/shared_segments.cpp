#include "server/ranks/shared_segments.hpp"

#include <cerrno>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <set>
#include <sstream>
#include <string>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/files/descriptor.hpp"

namespace rcb::ranks {
namespace {

// The paths of what this process has mapped as shared.
std::set<std::string> shared_paths() {
  std::set<std::string> paths;
  std::ifstream in("/proc/self/maps");
  for (std::string line; std::getline(in, line);) {
    std::istringstream fields(line);
    std::string range, access, offset, device, inode, path;
    fields >> range >> access >> offset >> device >> inode;
    std::getline(fields >> std::ws, path);
    if (access.size() == 4 && access[3] == 's' && path.starts_with('/')) paths.insert(path);
  }
  return paths;
}

Status allocate(const std::string& path) {
  constexpr std::int64_t kBlockBytes = 512;  // of st_blocks
  struct stat info {};
  // Only regular files are opened: opening a device may do something.
  if (::lstat(path.c_str(), &info) != 0 || !S_ISREG(info.st_mode) || info.st_uid != ::geteuid()) return {};
  if (info.st_size == 0 || info.st_blocks * kBlockBytes >= info.st_size) return {};
  const Descriptor file(::open(path.c_str(), O_RDWR | O_CLOEXEC | O_NOFOLLOW));
  if (!file.open()) return {};
  // Not posix_fallocate(): where the file system can't, that would write zeros between others' writes.
  while (::fallocate(file.get(), 0, 0, info.st_size) != 0) {
    if (errno == EINTR) continue;
    if (errno != ENOSPC && errno != EDQUOT && errno != ENOMEM) return {};
    return {Code::io_error, fmt::format("{}, of {} KiB, through which ranks share memory: {}", path,
                                        info.st_size >> 10U, std::strerror(errno))};
  }
  return {};
}

}  // namespace

Status allocate_shared_segments() {
  for (const std::string& path : shared_paths())
    if (Status status = allocate(path); !status.ok()) return status;
  return {};
}

}  // namespace rcb::ranks
