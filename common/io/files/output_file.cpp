#include "common/io/files/output_file.hpp"

#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/io/files/roots.hpp"

namespace rcb::io {
namespace {

std::string name_beside(const std::string& name) {
  static std::atomic<unsigned> number{0};
  return fmt::format("{}.{}-{}.part", name, ::getpid(), number++);
}

}  // namespace

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
    beside = name_beside(target);
  }
  const int flags = beside.empty() ? O_WRONLY : O_WRONLY | O_CREAT | O_EXCL;
  const int descriptor = ::open((beside.empty() ? target : beside).c_str(), flags | O_CLOEXEC | O_NOCTTY, 0666);
  if (descriptor < 0) {
    const int error = errno;
    return Status(Code::io_error, fmt::format("{}: can't be written: {}", path, std::strerror(error)),
                  error == ENOENT ? "make its directory first" : "check the directory's permissions and space");
  }
  return OutputFile(AT_FDCWD, std::move(target), std::move(beside), path, descriptor);
}

Result<OutputFile> OutputFile::create_in(const Folder& folder, const std::string& name) {
  std::string beside = name_beside(name);
  const std::string path = folder.path() + "/" + name;
  const int kept = ::fcntl(folder.descriptor(), F_DUPFD_CLOEXEC, 0);
  const int flags = O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC;
  const int descriptor = kept < 0 ? -1 : ::openat(kept, beside.c_str(), flags, 0666);
  if (descriptor >= 0) return OutputFile(kept, name, std::move(beside), path, descriptor);
  const Status failed(Code::io_error, fmt::format("{}: can't be written: {}", path, std::strerror(errno)),
                      "check the directory's permissions and space");
  if (kept >= 0) ::close(kept);
  return failed;
}

OutputFile::OutputFile(int folder, std::string name, std::string beside, std::string path, int descriptor)
    : folder_(folder),
      name_(std::move(name)),
      beside_(std::move(beside)),
      path_(std::move(path)),
      descriptor_(descriptor) {}

OutputFile::OutputFile(OutputFile&& other) noexcept
    : folder_(std::exchange(other.folder_, AT_FDCWD)),
      name_(std::move(other.name_)),
      beside_(std::move(other.beside_)),
      path_(std::move(other.path_)),
      descriptor_(std::exchange(other.descriptor_, -1)) {}

OutputFile::~OutputFile() {
  if (descriptor_ >= 0) {
    ::close(descriptor_);
    if (!beside_.empty()) ::unlinkat(folder_, beside_.c_str(), 0);
  }
  if (folder_ >= 0) ::close(folder_);
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
    if (!beside_.empty()) ::unlinkat(folder_, beside_.c_str(), 0);
    return status;
  }
  if (!beside_.empty() && ::renameat(folder_, beside_.c_str(), folder_, name_.c_str()) != 0) {
    const Status status = failed("renamed");
    ::unlinkat(folder_, beside_.c_str(), 0);
    return status;
  }
  return {};
}

Status write_file(const std::string& path, std::string_view content) {
  auto file = OutputFile::create(path);
  if (!file.ok()) return file.status();
  if (Status status = file->write(content); !status.ok()) return status;
  return file->commit();
}

}  // namespace rcb::io
