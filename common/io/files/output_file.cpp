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

#include "common/files/read_write.hpp"
#include "common/io/files/roots.hpp"

namespace rcb::io {
namespace {

constexpr const char* kOpenFiles = "/proc/self/fd";

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
  OutputFile out(Descriptor(), std::move(target), std::move(beside), path);
  if (!out.open()) {
    const int error = errno;
    return Status(Code::io_error, fmt::format("{}: can't be written: {}", path, std::strerror(error)),
                  error == ENOENT  ? "make its directory first"
                  : error == ENXIO ? "nobody reads it: start its reader first"
                                   : "check the directory's permissions and space");
  }
  return out;
}

Result<OutputFile> OutputFile::create_in(const Folder& folder, const std::string& name) {
  OutputFile out(Descriptor(::fcntl(folder.descriptor(), F_DUPFD_CLOEXEC, 0)), name, name_beside(name),
                 folder.path() + "/" + name);
  if (out.folder_.open() && out.open()) return out;
  return Status(Code::io_error, fmt::format("{}: can't be written: {}", out.path_, std::strerror(errno)),
                "check the directory's permissions and space");
}

OutputFile::OutputFile(Descriptor folder, std::string name, std::string beside, std::string path)
    : folder_(std::move(folder)), name_(std::move(name)), beside_(std::move(beside)), path_(std::move(path)) {}

OutputFile::~OutputFile() {
  if (file_.open()) remove();
}

bool OutputFile::open() {
  const auto open_at = [this](const std::string& path, int flags) {
    file_ = Descriptor(::openat(folder(), path.c_str(), O_WRONLY | O_CLOEXEC | O_NOCTTY | flags, 0666));
    return file_.open();
  };
  // A FIFO that nobody reads would block for ever.
  if (!regular()) return open_at(name_, O_NONBLOCK) && ::fcntl(file_.get(), F_SETFL, O_WRONLY) == 0;
  const std::size_t slash = beside_.rfind('/');
  const std::string parent = slash == std::string::npos ? "." : beside_.substr(0, slash + 1);
  nameless_ = ::access(kOpenFiles, X_OK) == 0 && open_at(parent, O_TMPFILE);
  return nameless_ || open_at(beside_, O_CREAT | O_EXCL | O_NOFOLLOW);
}

bool OutputFile::give_name() const {
  const std::string open = fmt::format("{}/{}", kOpenFiles, file_.get());
  return ::linkat(AT_FDCWD, open.c_str(), folder(), beside_.c_str(), AT_SYMLINK_FOLLOW) == 0;
}

void OutputFile::remove() const {
  if (!beside_.empty() && !nameless_) ::unlinkat(folder(), beside_.c_str(), 0);
}

int OutputFile::folder() const { return folder_.open() ? folder_.get() : AT_FDCWD; }

Status OutputFile::failed(const char* what) const {
  return Status(Code::io_error, fmt::format("{}: can't be {}: {}", path_, what, std::strerror(errno)),
                "check the space on that disk");
}

Status OutputFile::write(std::string_view bytes) {
  return write_all(file_.get(), bytes) ? Status() : failed("written");
}

Status OutputFile::write_at_begin(std::string_view bytes) {
  if (::lseek(file_.get(), 0, SEEK_SET) != 0) return failed("completed");
  return write(bytes);
}

Status OutputFile::commit() {
  if (nameless_ && !give_name()) return failed("named");
  nameless_ = false;
  const bool closed = file_.close();
  if (closed && (beside_.empty() || ::renameat(folder(), beside_.c_str(), folder(), name_.c_str()) == 0)) return {};
  const Status status = failed(closed ? "renamed" : "closed");
  remove();
  return status;
}

Status write_file(const std::string& path, std::string_view content) {
  auto file = OutputFile::create(path);
  if (!file.ok()) return file.status();
  if (Status status = file->write(content); !status.ok()) return status;
  return file->commit();
}

}  // namespace rcb::io
