// InputFile: a regular file open for reading. It is read, not mapped: a mapped file that shrinks while it is read
// would kill the process.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "common/base/status.hpp"
#include "common/files/descriptor.hpp"

namespace rcb::io {

// Identifies a file and its state: different once it was replaced, truncated or written to.
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
  // Like open(), for a name in an open folder, which must not be a symbolic link; path: for messages.
  static Result<InputFile> open_in(int folder, const std::string& name, const std::string& path);
  // Of what has just been opened; if it wasn't, errno says why. hint: of a file that isn't there.
  static Result<InputFile> take(Descriptor descriptor, const std::string& path, const char* hint = "check the path");

  const std::string& path() const { return path_; }
  int descriptor() const { return descriptor_.get(); }
  // A name that opens this very file again, for libraries that take names.
  std::string name_by_descriptor() const;
  // As it was when the file was opened.
  const FileVersion& version() const { return version_; }
  std::uint64_t size() const { return version_.size; }
  // Checks that the file is still as it was when opened, so that all reads saw one state of it. Errors: io_error.
  Status check_unchanged() const;
  // Reads all of these bytes. Errors: io_error (also for a file that was truncated since).
  Status read_at(std::uint64_t offset, void* to, std::size_t bytes) const;
  // Once `stop` is set, nothing is read any more: read_at() and check_stop() return aborted.
  void set_stop(const std::atomic<bool>* stop) { stop_ = stop; }
  Status check_stop() const {
    if (stop_ == nullptr || !*stop_) return {};
    return {Code::aborted, path_ + ": reading was given up"};
  }
  // Whether the file begins with these bytes.
  bool starts_with(std::string_view magic) const;

 private:
  InputFile(std::string path, Descriptor descriptor, const FileVersion& version);

  std::string path_;
  Descriptor descriptor_;
  FileVersion version_;
  const std::atomic<bool>* stop_ = nullptr;
};

// Text of a file for a message: control characters escaped, at most 40 characters.
std::string shown(std::string_view text);

}  // namespace rcb::io
