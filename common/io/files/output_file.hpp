// OutputFile: written to a temporary file beside its name and renamed at the end, so that no reader finds half a file.
// Where the file system can do it, that file has no name until then, so that nothing of it stays when the process is
// killed. What exists and is no regular file (a terminal, a pipe) is written directly.
#pragma once

#include <string>
#include <string_view>

#include "common/base/status.hpp"
#include "common/files/descriptor.hpp"

namespace rcb::io {

class Folder;

class OutputFile {
 public:
  static Result<OutputFile> create(const std::string& path);
  // In an open folder. What has this name is replaced; a symbolic link is not followed.
  static Result<OutputFile> create_in(const Folder& folder, const std::string& name);
  OutputFile(OutputFile&& other) noexcept = default;
  OutputFile& operator=(OutputFile&&) = delete;
  ~OutputFile();  // removes what was not committed

  Status write(std::string_view bytes);
  // Overwrites the file's first bytes; regular files only.
  Status write_at_begin(std::string_view bytes);
  Status commit();
  bool regular() const { return !beside_.empty(); }

 private:
  OutputFile(Descriptor folder, std::string name, std::string beside, std::string path);
  bool open();  // false: see errno
  Status failed(const char* what) const;
  int folder() const;  // for openat(2)
  bool give_name() const;
  void remove() const;

  Descriptor folder_;   // an open folder in which the names are; none: the working directory
  std::string name_;    // with symbolic links resolved
  std::string beside_;  // the temporary file; empty: written directly
  std::string path_;    // for messages
  Descriptor file_;
  bool nameless_ = false;  // the temporary file has no name yet
};

// Writes a whole file.
Status write_file(const std::string& path, std::string_view content);

}  // namespace rcb::io
