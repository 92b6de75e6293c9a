#include "common/files/paths.hpp"

#include <array>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <system_error>

#include <fmt/format.h>
#include <pwd.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/random.hpp"
#include "common/files/own_files.hpp"

namespace rcb {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kNameBytesMax = 200;  // file systems allow 255

// The variable's value if it is an absolute path, else empty (XDG says that relative paths are to be ignored).
std::string absolute_variable(const char* name) {
  const char* value = std::getenv(name);
  return value != nullptr && value[0] == '/' ? value : "";
}

bool is_own_folder(const std::string& path) {
  struct stat info {};
  return ::stat(path.c_str(), &info) == 0 && S_ISDIR(info.st_mode) && info.st_uid == ::geteuid();
}

std::string home_directory() {
  if (std::string home = absolute_variable("HOME"); !home.empty()) return home;
  const passwd* entry = ::getpwuid(::geteuid());
  return entry != nullptr && entry->pw_dir != nullptr && entry->pw_dir[0] == '/' ? entry->pw_dir : "/";
}

std::string escape(std::string_view text) {
  std::string out;
  for (const char c : text) {
    const bool plain =
        (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '.' || c == '_' || c == '-';
    if (plain)
      out += c;
    else if (c == '/')
      out += '+';
    else
      out += fmt::format("%{:02X}", static_cast<unsigned char>(c));
  }
  if (out.size() <= kNameBytesMax) return out;
  std::uint64_t hash = 0;
  for (const char c : text) hash = mix64(hash ^ static_cast<unsigned char>(c));
  return fmt::format("{}%{:016x}", out.substr(0, kNameBytesMax - 17), hash);
}

}  // namespace

std::string default_socket_directory() {
  // Batch systems hand it on from another machine, where the folder isn't, and su from another user.
  if (const std::string runtime = absolute_variable("XDG_RUNTIME_DIR"); is_own_folder(runtime))
    return join_path(runtime, "rcbd");
  return fmt::format("/tmp/rcbd-{}", ::geteuid());
}

std::string default_socket_path() { return join_path(default_socket_directory(), "rcbd.sock"); }

std::string data_directory_for(std::string_view endpoint) {
  std::string base = absolute_variable("XDG_STATE_HOME");
  if (base.empty()) base = join_path(home_directory(), ".local/state");
  std::string name(endpoint);
  const bool is_unix = name.starts_with("unix:");
  if (is_unix || name.find('/') != std::string::npos) {
    std::error_code error;
    const fs::path path = is_unix ? name.substr(5) : name;
    const fs::path absolute = fs::absolute(path, error);
    name = "unix:" + (error ? path : absolute).lexically_normal().string();
  }
  return join_path(join_path(base, "rcbd"), escape(name));
}

Status make_private_directory(const std::string& path) {
  struct stat info {};
  if (::lstat(path.c_str(), &info) == 0) {
    if (!S_ISDIR(info.st_mode))
      return {Code::io_error, fmt::format("{} is not a directory", path), "remove it, or name another place"};
    if (info.st_uid == ::geteuid() && (info.st_mode & 0077) != 0 && ::chmod(path.c_str(), 0700) != 0)
      return {Code::not_authorised, fmt::format("{} is open to other users: {}", path, std::strerror(errno)),
              fmt::format("chmod 0700 {}", path)};
  }
  return make_own_directory(path);
}

Status make_directory(const std::string& path) {
  std::error_code error;
  fs::create_directories(path, error);
  if (!error && fs::is_directory(path, error)) return {};
  return {Code::io_error,
          fmt::format("can't make the directory {}: {}", path, error ? error.message() : "a file is there"),
          error == std::errc::file_exists ? "what has this name is no directory: name another place"
                                          : "check the permissions of the directory above it, or name another place"};
}

std::string host_name() {
  std::array<char, 256> name{};
  ::gethostname(name.data(), name.size() - 1);
  return name.data();
}

std::string machine_key() {
  const auto space = [](const char* kind) {
    std::error_code ignored;
    return fs::read_symlink(fmt::format("/proc/self/ns/{}", kind), ignored).string();
  };
  std::string boot;
  std::ifstream("/proc/sys/kernel/random/boot_id") >> boot;
  return fmt::format("{} {} {} {}", host_name(), boot, space("net"), space("mnt"));
}

std::vector<std::string> names_in(const std::string& directory, std::error_code& fault) {
  std::vector<std::string> names;
  for (fs::directory_iterator entry(directory, fault), end; !fault && entry != end; entry.increment(fault))
    names.push_back(entry->path().filename().string());
  return names;
}

std::string join_path(std::string_view directory, std::string_view name) {
  std::string out(directory);
  if (!out.empty() && out.back() != '/') out += '/';
  out += name;
  return out;
}

}  // namespace rcb
