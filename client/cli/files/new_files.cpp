#include "client/cli/files/new_files.hpp"

#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <system_error>

#include <fmt/format.h>
#include <unistd.h>

#include "common/files/paths.hpp"

namespace rcb::cli {

Result<NewFiles> NewFiles::begin(const std::string& directory) {
  std::error_code unknown;
  const bool there = std::filesystem::exists(directory, unknown);
  if (Status status = make_directory(directory); !status) return status;
  std::string hidden = join_path(directory, ".rcbctl-XXXXXX");
  if (mkdtemp(hidden.data()) == nullptr) {
    const int error = errno;
    if (!there) rmdir(directory.c_str());
    return Status(Code::io_error, fmt::format("nothing can be made in {}: {}", directory, std::strerror(error)),
                  "check the folder's permissions and space, or name another one");
  }
  return NewFiles(directory, std::move(hidden), !there);
}

NewFiles::~NewFiles() {
  if (hidden_.empty()) return;
  std::error_code ignored;
  std::filesystem::remove_all(hidden_, ignored);
  if (made_) rmdir(directory_.c_str());
}

Status NewFiles::commit(const std::vector<std::string>& names) {
  std::error_code unknown;
  for (const std::string& name : names)
    if (const std::string path = join_path(directory_, name); std::filesystem::is_directory(path, unknown))
      return {Code::io_error, fmt::format("{}: is a directory", path), "remove it, or name another folder"};
  for (const std::string& name : names)
    if (const std::string path = join_path(directory_, name);
        std::rename(join_path(hidden_, name).c_str(), path.c_str()) != 0)
      return {Code::io_error, fmt::format("{}: can't be renamed: {}", path, std::strerror(errno))};
  made_ = false;
  return {};
}

}  // namespace rcb::cli
