// Directories for the files of a test.
#pragma once

#include <cstddef>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <string_view>
#include <system_error>

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/check.hpp"

namespace rcb::testing {

// The bytes of a file; none where it can't be read.
inline std::string contents(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

// Of a file, without its kind.
inline unsigned mode_of(const std::string& path) {
  struct stat info {};
  EXPECT_EQ(::lstat(path.c_str(), &info), 0) << path;
  return info.st_mode & 0777U;
}

// A new private directory, removed at the end. Its path is short enough for sockets.
class Directory {
 public:
  Directory() { RCB_CHECK(::mkdtemp(path_.data()) != nullptr, "a directory can be made in /tmp"); }
  Directory(const Directory&) = delete;
  Directory& operator=(const Directory&) = delete;
  ~Directory() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  const std::string& path() const { return path_; }
  std::string operator/(std::string_view name) const { return path_ + "/" + std::string(name); }
  std::string write(std::string_view name, std::string_view bytes) const {
    const std::string path = *this / name;
    // A new file each time: some file systems sync one that is truncated and written again.
    std::filesystem::remove(path);
    std::ofstream(path, std::ios::binary) << bytes;
    return path;
  }
  std::size_t file_count() const {
    return static_cast<std::size_t>(
        std::distance(std::filesystem::directory_iterator(path_), std::filesystem::directory_iterator()));
  }

 private:
  std::string path_ = "/tmp/rcb-test-XXXXXX";
};

// A fixture with such a directory.
class DirectoryTest : public ::testing::Test {
 protected:
  std::string at(std::string_view name) const { return made_ / name; }

 private:
  const Directory made_;

 protected:
  const std::string directory_ = made_.path();
};

}  // namespace rcb::testing
