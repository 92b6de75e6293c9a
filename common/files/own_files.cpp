#include "common/files/own_files.hpp"

#include <cerrno>
#include <climits>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <list>

#include <fcntl.h>
#include <fmt/format.h>
#include <grp.h>
#include <pwd.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/files/paths.hpp"
#include "common/files/read_write.hpp"

namespace rcb {
namespace {

constexpr int kLinksMax = 40;  // the kernel's own limit
constexpr const char* kElsewhere = "name another place, for example below your home directory";

Status failed(const std::string& path, const char* what) {
  return {Code::io_error, fmt::format("{}: {}: {}", path, what, std::strerror(errno)), kElsewhere};
}

// In a user namespace that doesn't map the machine's root, such as that of a container started by a user, root's files
// appear to belong to the overflow user, which this returns. Files of other unmapped users can't be told from root's.
// Returns 0, which is trusted anyway, where all users are mapped.
uid_t unknown_root() {
  std::uint64_t first = 0;
  std::uint64_t outside = 0;
  std::uint64_t count = 0;
  constexpr std::uint64_t kEverybody = 0xFFFFFFFF;
  if (std::ifstream map("/proc/self/uid_map"); !(map >> first >> outside >> count) || count == kEverybody) return 0;
  uid_t user = 0;
  std::ifstream("/proc/sys/kernel/overflowuid") >> user;
  return user;
}

bool is_trusted(uid_t user) {
  static const uid_t unknown = unknown_root();
  return user == 0 || user == ::geteuid() || user == unknown;
}

// True if `group` is this user's private group, as many systems make one for each user: it has no other members.
bool is_own_group(gid_t group) {
  const passwd* user = ::getpwuid(::geteuid());
  if (user == nullptr || user->pw_gid != group) return false;
  const std::string name = user->pw_name;
  const ::group* entry = ::getgrgid(group);
  if (entry == nullptr || name != entry->gr_name) return false;
  for (char** member = entry->gr_mem; *member != nullptr; ++member)
    if (name != *member) return false;
  return true;
}

bool others_may_write(const struct stat& info) {
  if ((info.st_mode & S_IWOTH) != 0) return true;
  return (info.st_mode & S_IWGRP) != 0 && info.st_gid != 0 && !is_own_group(info.st_gid);
}

Status belongs_to_another(const std::string& path, const std::string& component, const char* kind, uid_t user) {
  return {Code::not_authorised,
          fmt::format("{}: the {} {} belongs to user {}, who could put other files there", path, kind, component, user),
          kElsewhere};
}

Status check_component(const std::string& path, const std::string& component, const struct stat& info, bool own) {
  if (!S_ISDIR(info.st_mode))
    return {Code::io_error, fmt::format("{}: {} is not a directory", path, component), kElsewhere};
  if (!is_trusted(info.st_uid) || (own && info.st_uid != ::geteuid()))
    return belongs_to_another(path, component, "directory", info.st_uid);
  if (others_may_write(info) && (own || (info.st_mode & S_ISVTX) == 0))
    return {Code::not_authorised,
            fmt::format("{}: the directory {} may be written by others (mode {:04o})", path, component,
                        info.st_mode & 07777U),
            fmt::format("chmod go-w {}, or {}", component, kElsewhere)};
  return {};
}

std::list<std::string> components_of(const std::filesystem::path& path) {
  std::list<std::string> list;
  for (const auto& part : path.relative_path())
    if (!part.empty() && part != ".") list.push_back(part.string());
  return list;
}

Result<std::string> read_link(const std::string& path, const std::string& link) {
  std::string target(PATH_MAX, '\0');
  const ssize_t bytes = ::readlink(link.c_str(), target.data(), target.size());
  if (bytes < 0) return failed(path, link.c_str());
  target.resize(static_cast<std::size_t>(bytes));
  return target;
}

// own: components that are missing are made, and the last one must belong to this user.
Status walk(const std::string& path, bool own) {
  std::error_code error;
  const std::filesystem::path absolute = std::filesystem::absolute(path, error);
  if (error || path.empty()) return {Code::io_error, fmt::format("'{}' is no path of a directory", path), kElsewhere};
  std::list<std::string> ahead = components_of(absolute);
  std::string here = "/";  // checked so far, all symbolic links resolved
  int links = 0;
  while (!ahead.empty()) {
    const std::string name = ahead.front();
    ahead.pop_front();
    if (name == "..") {
      here = std::filesystem::path(here).parent_path().string();
      continue;
    }
    const std::string next = join_path(here, name);
    struct stat info {};
    if (own && ::lstat(next.c_str(), &info) != 0 && errno == ENOENT && ::mkdir(next.c_str(), 0700) != 0 &&
        errno != EEXIST)
      return failed(path, "can't be made");
    if (::lstat(next.c_str(), &info) != 0) return failed(path, "can't be examined");
    if (S_ISLNK(info.st_mode)) {
      if (!is_trusted(info.st_uid)) return belongs_to_another(path, next, "symbolic link", info.st_uid);
      if (++links > kLinksMax) return {Code::io_error, path + ": too many symbolic links on the way", kElsewhere};
      auto target = read_link(path, next);
      if (!target.ok()) return target.status();
      if (target->starts_with('/')) here = "/";
      ahead.splice(ahead.begin(), components_of(*target));
      continue;
    }
    if (Status status = check_component(path, next, info, false); !status.ok()) return status;
    here = next;
  }
  struct stat info {};
  if (::lstat(here.c_str(), &info) != 0) return failed(path, "can't be examined");
  return check_component(path, here, info, own);
}

}  // namespace

Status make_own_directory(const std::string& path) { return walk(path, true); }

Status naming(std::string_view option, const Status& status) {
  return {status.code(), status.message(), fmt::format("{}, with {}", status.hint(), option)};
}

Status check_parent_directory(const std::string& path) { return walk(path, false); }

bool is_own_directory(const std::string& path) {
  struct stat info {};
  return ::lstat(path.c_str(), &info) == 0 && S_ISDIR(info.st_mode) && info.st_uid == ::geteuid();
}

Result<Descriptor> open_own_file(const std::string& path, int flags) {
  // O_NONBLOCK: opening a FIFO would otherwise block.
  Descriptor file(::open(path.c_str(), flags | O_NOFOLLOW | O_CLOEXEC | O_NONBLOCK, 0600));
  const char* hint = "remove it, or name another place";
  if (!file.open()) {
    if (errno == ELOOP) return Status(Code::not_authorised, path + " is a symbolic link", hint);
    if (errno == ENXIO || errno == EISDIR) return Status(Code::not_authorised, path + " is not a regular file", hint);
    const Code code = errno == ENOENT ? Code::not_found : errno == EACCES ? Code::not_authorised : Code::io_error;
    return Status(code, fmt::format("can't open {}: {}", path, std::strerror(errno)), errno == EACCES ? hint : "");
  }
  struct stat info {};
  std::string wrong;
  if (::fstat(file.get(), &info) != 0)
    wrong = fmt::format("can't be examined: {}", std::strerror(errno));
  else if (!S_ISREG(info.st_mode))
    wrong = "is not a regular file";
  else if (info.st_uid != ::geteuid())
    wrong = fmt::format("belongs to user {}, not to this one ({})", info.st_uid, ::geteuid());
  else if (info.st_nlink > 1)
    wrong = fmt::format("has {} names (hard links), of which others may be somebody else's", info.st_nlink);
  else if ((info.st_mode & 0022) != 0)
    wrong = fmt::format("may be written by others (mode {:04o})", info.st_mode & 07777U);
  if (wrong.empty()) return file;
  return Status(Code::not_authorised, fmt::format("{} {}", path, wrong), hint);
}

Status write_own_file(const std::string& path, std::string_view text) {
  std::string temporary = path + ".XXXXXX";
  Descriptor file(::mkostemp(temporary.data(), O_CLOEXEC));
  if (!file.open()) return {Code::io_error, fmt::format("can't write {}: {}", path, std::strerror(errno))};
  const bool written = write_all(file.get(), text) && ::fsync(file.get()) == 0;
  const int reason = errno;
  file = Descriptor();
  if (written && ::rename(temporary.c_str(), path.c_str()) == 0) return {};
  const Status failed(Code::io_error, fmt::format("can't write {}: {}", path, std::strerror(written ? errno : reason)));
  ::unlink(temporary.c_str());
  return failed;
}

}  // namespace rcb
