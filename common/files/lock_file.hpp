// LockFile: a file that one process at a time has locked, with a note in it that tells who holds the lock.
//
// Invariants
// 1. The kernel frees the lock when the process ends, however it ends. So a file that a dead process left is no
//    obstacle.
// 2. The lock counts only while the locked file is the one at its path. take() checks this again after locking, so
//    there are never two holders, although the holder and anybody else may remove the file.
// 3. Only this user can open the file (mode 0600), so nobody else can lock it.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "common/base/status.hpp"
#include "common/files/descriptor.hpp"

namespace rcb {

class LockFile {
 public:
  // The longest note; longer ones are truncated. The file always has this size, so a note can be rewritten on a full
  // disk.
  static constexpr std::size_t kNoteBytes = 2048;

  // Errors: busy (another process holds it; holder() returns its note), io_error, not_authorised (not a file of this
  // user).
  static Result<LockFile> take(const std::string& path, std::string_view note);
  // The note of the process that holds the lock now; nothing if no process does.
  static std::optional<std::string> holder(const std::string& path);

  LockFile(LockFile&& other) noexcept = default;
  LockFile& operator=(LockFile&& other) noexcept;
  ~LockFile();  // removes the file, unless it has been replaced

  const std::string& path() const { return path_; }
  // False once the file has been removed or replaced: another process may then lock a new file at this path.
  bool in_place() const;
  Status write(std::string_view note) const;

 private:
  LockFile(std::string path, Descriptor file) : path_(std::move(path)), file_(std::move(file)) {}
  std::string path_;
  Descriptor file_;
};

}  // namespace rcb
