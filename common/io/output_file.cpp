#include "common/io/output_file.hpp"

#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

namespace rcb::io {

Result<OutputFile> OutputFile::create(const std::string& path) {
  std::string target = path;
  std::string beside;
  struct stat about {};
  const bool exists = ::stat(path.c_str(), &about) == 0;
  if (exists && S_ISDIR(about.st_mode)) {
    return Status(Code::io_error, path + ": is a directory", "name a file in it");
  }
  if (!exists || S_ISREG(about.st_mode)) {
    if (char* real = exists ? ::realpath(path.c_str(), nullptr) : nullptr; real != nullptr) {
      target = real;
      std::free(real);
    }
    static std::atomic<unsigned> number{0};
    beside = fmt::format("{}.{}-{}.part", target, ::getpid(), number++);
  }
  const int flags = beside.empty() ? O_WRONLY : O_WRONLY | O_CREAT | O_EXCL;
  const int descriptor = ::open((beside.empty() ? target : beside).c_str(), flags | O_CLOEXEC | O_NOCTTY, 0666);
  if (descriptor < 0) {
    const int error = errno;
    return Status(Code::io_error, fmt::format("{}: can't be written: {}", path, std::strerror(error)),
                  error == ENOENT ? "make its directory first" : "check the directory's permissions and space");
  }
  return OutputFile(std::move(target), std::move(beside), descriptor);
}

OutputFile::OutputFile(std::string path, std::string beside, int descriptor)
    : path_(std::move(path)), beside_(std::move(beside)), descriptor_(descriptor) {}

OutputFile::OutputFile(OutputFile&& other) noexcept
    : path_(std::move(other.path_)),
      beside_(std::move(other.beside_)),
      descriptor_(std::exchange(other.descriptor_, -1)) {}

OutputFile::~OutputFile() {
  if (descriptor_ < 0) return;
  ::close(descriptor_);
  if (!beside_.empty()) ::unlink(beside_.c_str());
}

Status OutputFile::failed(const char* what) const {
  return Status(Code::io_error, fmt::format("{}: can't be {}: {}", path_, what, std::strerror(errno)),
                "check the space on that disk");
}

Status OutputFile::write(std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t put = ::write(descriptor_, bytes.data(), bytes.size());
    if (put < 0 && errno == EINTR) continue;
    if (put < 0) return failed("written");
    bytes.remove_prefix(static_cast<std::size_t>(put));
  }
  return {};
}

Status OutputFile::write_at_begin(std::string_view bytes) {
  if (::lseek(descriptor_, 0, SEEK_SET) != 0) return failed("completed");
  return write(bytes);
}

Status OutputFile::commit() {
  if (::close(std::exchange(descriptor_, -1)) != 0) {
    const Status status = failed("closed");
    if (!beside_.empty()) ::unlink(beside_.c_str());
    return status;
  }
  if (!beside_.empty() && ::rename(beside_.c_str(), path_.c_str()) != 0) {
    const Status status = failed("renamed");
    ::unlink(beside_.c_str());
    return status;
  }
  return {};
}

}  // namespace rcb::io
