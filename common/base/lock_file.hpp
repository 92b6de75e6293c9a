// LockFile: a file that one process at a time has locked, with a note in it that says who that is.
//
// Invariants
// 1. The kernel frees the lock with the process, however that ends; a file that a dead process left is no obstacle.
// 2. The lock counts only while the file stands at its path: whoever takes it looks again once it has it, so that a
//    file may be removed by its holder, and by anybody else, without two holders.
// 3. Only this user can open the file (mode 0600), so nobody else can lock it.
#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "common/base/status.hpp"

namespace rcb {

class LockFile {
 public:
  // The longest note; longer ones are cut. The file always has this size, so that a note can be changed on a full disk.
  static constexpr std::size_t kNoteBytes = 2048;

  // Errors: busy (somebody has it; what note they left: holder()), io_error, not_authorised (not a file of ours).
  static Result<LockFile> take(const std::string& path, std::string_view note);
  // The note of the process that has it locked now; nothing where nobody has.
  static std::optional<std::string> holder(const std::string& path);

  LockFile(LockFile&& other) noexcept;
  LockFile& operator=(LockFile&& other) noexcept;
  ~LockFile();  // removes the file, unless another stands there by now

  const std::string& path() const { return path_; }
  // False once somebody has removed or replaced the file: then another may be taken at its path.
  bool in_place() const;
  Status write(std::string_view note) const;

 private:
  LockFile(std::string path, int file) : path_(std::move(path)), file_(file) {}
  std::string path_;
  int file_ = -1;
};

}  // namespace rcb
