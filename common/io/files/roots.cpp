#include "common/io/files/roots.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>

namespace rcb::io {
namespace {

namespace fs = std::filesystem;

constexpr int kFolderFlags = O_PATH | O_DIRECTORY | O_CLOEXEC;

// The absolute path without symbolic links, as far as it exists; the rest as it is written.
fs::path resolved(const std::string& path) {
  std::error_code error;
  const fs::path absolute = fs::absolute(path, error);
  const fs::path real = fs::weakly_canonical(absolute, error);
  return error ? absolute.lexically_normal() : real;
}

Status failed(const std::string& path, int error, const char* what) {
  return {Code::io_error, fmt::format("{}: can't be {}: {}", path, what, std::strerror(error)),
          "check the permissions of the folders on the way"};
}

}  // namespace

// A resolved path below a root, as the names that lead there.
struct Roots::Place {
  const Folder& root;
  std::vector<std::string> names;

  // Opens the folder of the first `count` names.
  Result<Folder> walk(std::size_t count, bool make) const {
    Folder at(root.path(), ::openat(root.descriptor(), ".", kFolderFlags));
    if (at.descriptor() < 0) return failed(root.path(), errno, "opened");
    for (std::size_t i = 0; i < count; ++i) {
      const std::string path = (fs::path(at.path()) / names[i]).string();
      if (make && ::mkdirat(at.descriptor(), names[i].c_str(), 0777) != 0 && errno != EEXIST)
        return failed(path, errno, "made");
      Folder next(path, ::openat(at.descriptor(), names[i].c_str(), kFolderFlags | O_NOFOLLOW));
      if (next.descriptor() < 0 && errno == ENOENT) return Status(Code::not_found, path + ": no such folder");
      if (next.descriptor() < 0) return failed(path, errno, "opened");
      at = std::move(next);
    }
    return at;
  }
};

Status Roots::add(const std::string& folder) {
  const std::string path = resolved(folder).string();
  Folder opened(path, ::open(path.c_str(), kFolderFlags));
  if (opened.descriptor() < 0) return failed(folder, errno, "opened as a folder for clients' files");
  folders_.push_back(std::move(opened));
  return {};
}

Result<Roots::Place> Roots::place_of(const std::string& path) const {
  const fs::path real = resolved(path);
  for (const Folder& folder : folders_) {
    const fs::path root(folder.path());
    const auto [left, rest] = std::mismatch(root.begin(), root.end(), real.begin(), real.end());
    if (left != root.end()) continue;
    Place place{folder, {}};
    bool plain = true;
    for (auto name = rest; name != real.end(); ++name) {
      if (name->empty()) continue;  // a slash at the end
      place.names.push_back(name->string());
      plain = plain && *name != ".." && *name != ".";
    }
    if (plain) return place;
  }
  std::string where;
  for (const Folder& folder : folders_) where += (where.empty() ? "" : ", ") + folder.path();
  return Status(Code::not_authorised,
                fmt::format("{} doesn't lie below {}", path,
                            where.empty() ? "a folder for clients' files, since there is none"
                                          : "the folders for clients' files: " + where),
                "start the service with --files-below DIR, or send the data instead of the name");
}

Result<InputFile> Roots::open_file(const std::string& path) const {
  if (path.find('\0') != std::string::npos) return Status(Code::invalid_argument, "a file name holds a NUL byte");
  const auto place = place_of(path);
  if (!place.ok()) return place.status();
  if (place->names.empty()) return Status(Code::io_error, path + ": is a directory", "name a file in it");
  const auto folder = place->walk(place->names.size() - 1, false);
  if (!folder.ok()) return folder.status();
  return InputFile::open_in(folder->descriptor(), place->names.back(), path);
}

Result<Folder> Roots::make_folder(const std::string& path) const {
  const auto place = place_of(path);
  if (!place.ok()) return place.status();
  return place->walk(place->names.size(), true);
}

}  // namespace rcb::io
