#include "common/files/socket_file.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <filesystem>

#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include "common/files/descriptor.hpp"
#include "common/files/endpoint_lock.hpp"
#include "common/files/paths.hpp"

namespace rcb {
namespace {

bool is_rank_suffix(const std::string& text) {
  return !text.empty() && std::all_of(text.begin(), text.end(), [](char c) { return c >= '0' && c <= '9'; });
}

// The existing ranks' sockets: PATH.0, PATH.1, ...
std::vector<std::string> rank_sockets(const std::string& path) {
  std::vector<std::string> found;
  const std::filesystem::path socket(path);
  const std::string begin = socket.filename().string() + ".";
  const std::string folder = socket.has_parent_path() ? socket.parent_path().string() : ".";
  std::error_code ignored;
  for (const std::string& name : names_in(folder, ignored))
    if (name.starts_with(begin) && is_rank_suffix(name.substr(begin.size()))) found.push_back(join_path(folder, name));
  return found;
}

}  // namespace

SocketState socket_state(const std::string& path) {
  struct stat info {};
  if (::lstat(path.c_str(), &info) != 0) return errno == ENOENT ? SocketState::absent : SocketState::foreign;
  sockaddr_un address{};
  if (!S_ISSOCK(info.st_mode) || info.st_uid != ::geteuid() || path.size() >= sizeof address.sun_path)
    return SocketState::foreign;
  address.sun_family = AF_UNIX;
  std::memcpy(address.sun_path, path.data(), path.size());
  // Non-blocking, since connecting to a service whose backlog is full would block.
  const Descriptor probe(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!probe.open()) return SocketState::foreign;
  const int result = ::connect(probe.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address);
  const int reason = result == 0 ? 0 : errno;
  if (reason == 0 || reason == EAGAIN) return SocketState::live;
  return reason == ECONNREFUSED ? SocketState::dead : SocketState::foreign;
}

std::vector<std::string> remove_dead_sockets(const std::string& path) {
  std::vector<std::string> removed;
  const auto remove = [&removed](const std::string& socket) {
    if (socket_state(socket) == SocketState::dead && ::unlink(socket.c_str()) == 0) removed.push_back(socket);
  };
  remove(path);
  // PATH.7 may also be the endpoint of another service, one that is about to listen.
  for (const std::string& socket : rank_sockets(path))
    if (!endpoint_holder("unix:" + socket)) remove(socket);
  return removed;
}

void remove_old_dead_sockets(const std::string& folder, const std::string& prefix) {
  constexpr std::time_t kSeconds = 60;
  std::error_code ignored;
  for (const std::string& name : names_in(folder, ignored)) {
    const std::string path = join_path(folder, name);
    struct stat info {};
    if (!name.starts_with(prefix) || ::lstat(path.c_str(), &info) != 0) continue;
    if (std::time(nullptr) - info.st_mtime > kSeconds && socket_state(path) == SocketState::dead)
      ::unlink(path.c_str());
  }
}

}  // namespace rcb
