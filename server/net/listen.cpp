#include "server/net/listen.hpp"

#include <cerrno>
#include <charconv>
#include <cstring>
#include <filesystem>
#include <thread>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/paths.hpp"

namespace rcb::net {
namespace {

// Holds the directory's flock, so that two services that find the same stale socket don't remove each other's.
class DirectoryLock {
 public:
  explicit DirectoryLock(const std::string& path) : file_(::open(path.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC)) {}
  DirectoryLock(const DirectoryLock&) = delete;
  DirectoryLock& operator=(const DirectoryLock&) = delete;
  ~DirectoryLock() {
    if (file_ >= 0) ::close(file_);
  }
  bool exists() const { return file_ >= 0; }
  bool take() const {
    constexpr int kTries = 40;  // 2 s
    for (int i = 0; i < kTries; ++i) {
      if (::flock(file_, LOCK_EX | LOCK_NB) == 0) return true;
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
    }
    return false;
  }

 private:
  int file_;
};

// Removes a socket that nobody listens on. Errors: busy, io_error.
Status remove_stale(asio::io_context& context, const std::string& path) {
  struct stat info {};
  if (::lstat(path.c_str(), &info) != 0) return {};
  if (!S_ISSOCK(info.st_mode))
    return {Code::io_error, fmt::format("{} is there and is not a socket", path), "name another place with --socket"};
  asio::local::stream_protocol::socket probe(context);
  error_code error;
  probe.open({}, error);
  if (!error) probe.non_blocking(true, error);  // a service with a full backlog would block the connect
  if (!error) probe.connect({path}, error);
  if (!error || error == asio::error::would_block || error == asio::error::try_again)
    return {Code::busy, fmt::format("a service already answers at unix:{}", path),
            "stop it ('rcbctl down'), or give this one another --socket"};
  if (error != asio::error::connection_refused)
    return {Code::io_error, fmt::format("can't tell whether {} is in use: {}", path, error.message())};
  if (::unlink(path.c_str()) != 0)
    return {Code::io_error, fmt::format("can't remove the stale socket {}: {}", path, std::strerror(errno))};
  return {};
}

struct HostPort {
  std::string host;
  std::string port;
};

Result<HostPort> split(const std::string& where) {
  const std::size_t colon = where.rfind(':');
  HostPort parts{where.substr(0, colon), colon == std::string::npos ? "" : where.substr(colon + 1)};
  if (parts.host.size() > 2 && parts.host.front() == '[' && parts.host.back() == ']')
    parts.host = parts.host.substr(1, parts.host.size() - 2);
  unsigned port = 65536;
  const char* end = parts.port.data() + parts.port.size();
  const auto [stop, fault] = std::from_chars(parts.port.data(), end, port);
  if (fault != std::errc() || stop != end || port > 65535 || parts.host.empty())
    return Status(Code::invalid_argument, fmt::format("'{}' is not HOST:PORT", where), "for example 127.0.0.1:7470");
  return parts;
}

}  // namespace

Result<UnixAcceptor> listen_unix(asio::io_context& context, const std::string& path) {
  if (path.empty() || path.size() > kSocketPathMax)
    return Status(
        Code::invalid_argument,
        fmt::format("the socket path has {} bytes, 1 to {} are possible: {}", path.size(), kSocketPathMax, path),
        "name a shorter one with --socket");
  if (path == default_socket_path()) {
    const Status made = make_private_directory(default_socket_directory());
    if (!made.ok()) return made;
  }
  std::string parent = std::filesystem::path(path).parent_path().string();
  if (parent.empty()) parent = ".";
  const DirectoryLock lock(parent);
  if (!lock.exists())
    return Status(Code::io_error, fmt::format("can't open the socket's directory {}: {}", parent, std::strerror(errno)),
                  "make it, or name another place with --socket");
  if (!lock.take()) return Status(Code::busy, fmt::format("another program keeps the directory {} locked", parent));
  Status status = remove_stale(context, path);
  if (!status.ok()) return status;
  UnixAcceptor acceptor(context);
  error_code error;
  acceptor.open({}, error);
  const mode_t mask = ::umask(0177);
  if (!error) acceptor.bind({path}, error);
  ::umask(mask);
  if (!error) acceptor.listen(asio::socket_base::max_listen_connections, error);
  if (error) return Status(Code::io_error, fmt::format("can't listen on unix:{}: {}", path, error.message()));
  return acceptor;
}

Result<TcpAcceptor> listen_tcp(asio::io_context& context, const std::string& where) {
  Result<HostPort> parts = split(where);
  if (!parts.ok()) return parts.status();
  error_code error;
  asio::ip::tcp::resolver resolver(context);
  const auto found = resolver.resolve(parts->host, parts->port, asio::ip::tcp::resolver::passive, error);
  if (error || found.empty())
    return Status(Code::invalid_argument, fmt::format("--listen {}: no such host: {}", where, error.message()));
  TcpAcceptor acceptor(context);
  const asio::ip::tcp::endpoint endpoint = found.begin()->endpoint();
  acceptor.open(endpoint.protocol(), error);
  if (!error) acceptor.set_option(asio::socket_base::reuse_address(true), error);
  if (!error) acceptor.bind(endpoint, error);
  if (!error) acceptor.listen(asio::socket_base::max_listen_connections, error);
  if (error == asio::error::address_in_use)
    return Status(Code::busy, fmt::format("{} is in use by another program", where), "name another with --listen");
  if (error) return Status(Code::io_error, fmt::format("can't listen on {}: {}", where, error.message()));
  return acceptor;
}

std::string bound_address(const TcpAcceptor& acceptor) {
  error_code error;
  const asio::ip::tcp::endpoint endpoint = acceptor.local_endpoint(error);
  if (error) return "";
  const std::string host = endpoint.address().to_string();
  return endpoint.address().is_v6() ? fmt::format("[{}]:{}", host, endpoint.port())
                                    : fmt::format("{}:{}", host, endpoint.port());
}

Status check_peer_user(int socket) {
  ucred peer{};
  socklen_t size = sizeof(peer);
  if (::getsockopt(socket, SOL_SOCKET, SO_PEERCRED, &peer, &size) != 0)
    return {Code::not_authorised, fmt::format("can't tell who connects: {}", std::strerror(errno))};
  if (peer.uid == ::geteuid() || peer.uid == 0) return {};
  return {Code::not_authorised, fmt::format("user {} is not the service's user ({})", peer.uid, ::geteuid()),
          "ask the service's owner, or start your own service"};
}

}  // namespace rcb::net
