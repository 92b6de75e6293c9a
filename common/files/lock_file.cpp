#include "common/files/lock_file.hpp"

#include <cerrno>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/files/own_files.hpp"
#include "common/files/read_write.hpp"

namespace rcb {
namespace {

constexpr int kTriesMax = 100;  // retries: each means that the file was replaced between opening and locking it

// A write lock on the whole file. It is taken for the open file description, so neither child processes nor other
// descriptors of this process affect it.
struct flock whole_file() {
  struct flock lock {};
  lock.l_type = F_WRLCK;
  lock.l_whence = SEEK_SET;
  return lock;
}

bool same_file(int file, const std::string& path) {
  struct stat opened {};
  struct stat named {};
  return ::fstat(file, &opened) == 0 && ::lstat(path.c_str(), &named) == 0 && opened.st_dev == named.st_dev &&
         opened.st_ino == named.st_ino;
}

std::string read_note(int file) {
  std::string note = read_some(file, LockFile::kNoteBytes);
  note.resize(note.find_last_not_of("\n") + 1);
  return note;
}

}  // namespace

Result<LockFile> LockFile::take(const std::string& path, std::string_view note) {
  for (int i = 0; i < kTriesMax; ++i) {
    auto file = open_own_file(path, O_RDWR | O_CREAT);
    if (!file.ok()) return file.status();
    struct stat about {};
    if (::fstat(file->get(), &about) != 0 || (about.st_size != 0 && about.st_size != std::int64_t{kNoteBytes}))
      return Status(Code::io_error, fmt::format("{} exists and is not a lock of rcbd's", path), "move it away");
    ::fchmod(file->get(), 0600);  // anyone who can open the file could lock it
    struct flock whole = whole_file();
    if (::fcntl(file->get(), F_OFD_SETLK, &whole) != 0) {
      const int reason = errno;
      if (reason == EAGAIN || reason == EACCES) return Status(Code::busy, fmt::format("{} is locked", path));
      return Status(Code::io_error, fmt::format("can't lock {}: {}", path, std::strerror(reason)),
                    "name a place on a file system that knows locks, such as a local disk");
    }
    if (!same_file(file->get(), path)) continue;
    LockFile lock(path, std::move(*file));
    if (Status written = lock.write(note); !written.ok()) return written;
    return lock;
  }
  return Status(Code::io_error, fmt::format("{} is replaced again and again", path));
}

std::optional<std::string> LockFile::holder(const std::string& path) {
  const Descriptor file(::open(path.c_str(), O_RDONLY | O_NOFOLLOW | O_CLOEXEC | O_NONBLOCK));
  struct flock whole = whole_file();
  if (!file.open() || ::fcntl(file.get(), F_OFD_GETLK, &whole) != 0 || whole.l_type == F_UNLCK) return std::nullopt;
  return read_note(file.get());
}

LockFile& LockFile::operator=(LockFile&& other) noexcept {
  std::swap(path_, other.path_);
  file_ = std::move(other.file_);
  return *this;
}

LockFile::~LockFile() {
  if (in_place()) ::unlink(path_.c_str());
}

bool LockFile::in_place() const { return same_file(file_.get(), path_); }

Status LockFile::write(std::string_view note) const {
  std::string text(note.substr(0, kNoteBytes));
  text.resize(kNoteBytes, '\n');
  const ssize_t bytes = ::pwrite(file_.get(), text.data(), text.size(), 0);
  if (bytes == static_cast<ssize_t>(text.size())) return {};
  return {Code::io_error, fmt::format("can't write {}: {}", path_, std::strerror(bytes < 0 ? errno : ENOSPC))};
}

}  // namespace rcb
