// InputFile: a regular file open for reading. It is read, not mapped: a mapped file that shrinks while it is read
// would kill the process.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "common/base/status.hpp"

namespace rcb::io {

// Which file it is, and in which state; another one once it was replaced, cut or written to.
struct FileVersion {
  std::uint64_t inode = 0;
  std::uint64_t size = 0;
  std::int64_t changed_nanoseconds = 0;  // since 1970
  friend bool operator==(const FileVersion&, const FileVersion&) = default;
};

class InputFile {
 public:
  // Errors: not_found; io_error where it can't be opened or is no regular file.
  static Result<InputFile> open(const std::string& path);
  // The same for a name in an open folder, which is no symbolic link; path: for messages.
  static Result<InputFile> open_in(int folder, const std::string& name, const std::string& path);
  InputFile(InputFile&& other) noexcept;
  InputFile& operator=(InputFile&& other) noexcept;
  InputFile(const InputFile&) = delete;
  InputFile& operator=(const InputFile&) = delete;
  ~InputFile();

  const std::string& path() const { return path_; }
  // Opens this very file again, for libraries that take names.
  std::string name_by_descriptor() const;
  // As they were when it was opened.
  const FileVersion& version() const { return version_; }
  std::uint64_t size() const { return version_.size; }
  // What was read until now is of the file as it was when opened. Errors: io_error.
  Status check_unchanged() const;
  // All of the bytes, or io_error (a file that was cut while it is read).
  Status read_at(std::uint64_t offset, void* to, std::size_t bytes) const;
  // Whether the file begins with these bytes.
  bool starts_with(std::string_view magic) const;

 private:
  InputFile(std::string path, int descriptor, const FileVersion& version);
  static Result<InputFile> opened(int descriptor, const std::string& path);

  std::string path_;
  int descriptor_ = -1;
  FileVersion version_;
};

// Text of a file made fit for a message: control characters escaped, at most 40 characters.
std::string shown(std::string_view text);

}  // namespace rcb::io
