// InputFile: a regular file open for reading. It is read, not mapped: a mapped file that shrinks while it is read
// would kill the process.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "common/base/status.hpp"

namespace rcb::io {

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
  std::uint64_t size() const { return size_; }  // as it was when opened
  // All of the bytes, or io_error (a file that was cut while it is read).
  Status read_at(std::uint64_t offset, void* to, std::size_t bytes) const;
  // Whether the file begins with these bytes.
  bool starts_with(std::string_view magic) const;

 private:
  InputFile(std::string path, int descriptor, std::uint64_t size);
  static Result<InputFile> opened(int descriptor, const std::string& path);

  std::string path_;
  int descriptor_ = -1;
  std::uint64_t size_ = 0;
};

// Text of a file made fit for a message: control characters escaped, at most 40 characters.
std::string shown(std::string_view text);

}  // namespace rcb::io
