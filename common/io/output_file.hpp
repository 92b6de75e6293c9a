// OutputFile: written beside its name and renamed at the end, so that no reader finds half a file. What is no regular
// file (a terminal, a pipe) is written as it is.
#pragma once

#include <string>
#include <string_view>

#include "common/base/status.hpp"

namespace rcb::io {

class OutputFile {
 public:
  static Result<OutputFile> create(const std::string& path);
  OutputFile(OutputFile&& other) noexcept;
  OutputFile& operator=(OutputFile&&) = delete;
  ~OutputFile();  // what was not committed is removed

  Status write(std::string_view bytes);
  // Over the file's first bytes, of a regular file only.
  Status write_at_begin(std::string_view bytes);
  Status commit();
  bool regular() const { return !beside_.empty(); }

 private:
  OutputFile(std::string path, std::string beside, int descriptor);
  Status failed(const char* what) const;

  std::string path_;    // symbolic links followed
  std::string beside_;  // empty: written in place
  int descriptor_ = -1;
};

}  // namespace rcb::io
