#include "server/net/sockets/listen.hpp"

#include <cerrno>
#include <cstring>
#include <optional>
#include <utility>

#include <fmt/format.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include "common/base/host_port.hpp"
#include "common/files/descriptor.hpp"
#include "common/files/paths.hpp"
#include "common/files/socket_file.hpp"
#include "common/tls/off_loopback.hpp"
#include "server/net/sockets/file_thread.hpp"

namespace rcb::net {
namespace {

// Connections that the kernel keeps until they are taken, as far as the system lets it (net.core.somaxconn).
constexpr int kBacklog = 4096;

// Removes a socket on which nobody listens. Errors: busy, io_error.
Status remove_stale(const std::string& path) {
  switch (socket_state(path)) {
    case SocketState::absent:
      return {};
    case SocketState::live:
      return {Code::busy, fmt::format("a service already answers at unix:{}", path),
              "stop it ('rcbctl down'), or give this one another endpoint"};
    case SocketState::foreign:
      return {Code::io_error, fmt::format("{} is there and is no socket of this user", path),
              "give the service another endpoint"};
    case SocketState::dead:
      break;
  }
  if (::unlink(path.c_str()) == 0 || errno == ENOENT) return {};
  return {Code::io_error, fmt::format("can't remove the stale socket {}: {}", path, std::strerror(errno))};
}

Status cannot_listen(const std::string& path, int fault) {
  return {Code::io_error, fmt::format("can't listen on unix:{}: {}", path, std::strerror(fault)),
          "make the socket's directory, or give the service another endpoint"};
}

// A socket that listens, and needs no context yet: on the thread of the files there may be none any more.
struct BoundSocket {
  Descriptor socket;
  SocketName name;  // destroyed before the socket, whose end frees the inode
};

Result<BoundSocket> bind_unix(const std::string& path) {
  if (path.empty() || path.size() > kSocketPathMax)
    return Status(
        Code::invalid_argument,
        fmt::format("the socket path has {} bytes, 1 to {} are possible: {}", path.size(), kSocketPathMax, path),
        "give the service an endpoint with a shorter path");
  if (Status status = remove_stale(path); !status.ok()) return status;
  Descriptor socket(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::memcpy(address.sun_path, path.data(), path.size());
  // The name that bind() makes has the mode of the socket (Linux). The umask would be that of all threads, also of one
  // that makes a folder meanwhile.
  const auto* const where = reinterpret_cast<const sockaddr*>(&address);
  if (!socket.open() || ::fchmod(socket.get(), 0600) != 0 || ::bind(socket.get(), where, sizeof(address)) != 0)
    return cannot_listen(path, errno);
  SocketName name(path);
  if (::listen(socket.get(), kBacklog) != 0) return cannot_listen(path, errno);
  return BoundSocket{std::move(socket), std::move(name)};
}

Result<UnixListener> take(asio::io_context& context, BoundSocket bound) {
  UnixAcceptor acceptor(context);
  error_code error;
  acceptor.assign({}, bound.socket.get(), error);
  if (error) return Status(Code::io_error, fmt::format("a socket can't be watched: {}", error.message()));
  static_cast<void>(bound.socket.release());
  return UnixListener{std::move(acceptor), std::move(bound.name)};
}

}  // namespace

Result<UnixListener> listen_unix(asio::io_context& context, const std::string& path) {
  Result<BoundSocket> bound = bind_unix(path);
  if (!bound.ok()) return bound.status();
  return take(context, std::move(*bound));
}

Status LastingListener::listen(asio::io_context& context, const std::string& path) {
  Result<UnixListener> listener = listen_unix(context, path);
  if (!listener.ok()) return listener.status();
  context_ = &context;
  path_ = path;
  listeners_.push_back(std::move(*listener));
  return {};
}

void LastingListener::start(std::function<void(UnixAcceptor&)> accept) {
  accept_ = std::move(accept);
  if (!listeners_.empty()) accept_(listeners_.back().acceptor);
}

struct LastingListener::Look {
  bool in_place = false;
  std::optional<Result<BoundSocket>> again;
};

void LastingListener::look() {
  if (!accept_ || looking_ || listeners_.empty() || !listeners_.back().acceptor.is_open()) return;
  const auto look = std::make_shared<Look>();
  const Status begun = FileThread::of(*context_).run(
      [look, place = listeners_.back().name.place(), path = path_, there = std::weak_ptr(there_)] {
        look->in_place = place.taken();
        // The disk may have answered only after the end of this object.
        if (!look->in_place && !there.expired()) look->again.emplace(bind_unix(path));
      },
      [this, look, there = std::weak_ptr(there_)] {
        if (there.expired()) return;
        looking_ = false;
        found(*look);
      });
  looking_ = begun.ok();  // otherwise the next call tries again
}

void LastingListener::found(Look& look) {
  if (look.in_place || !listeners_.back().acceptor.is_open())
    return;  // closed meanwhile: the new socket goes with `look`
  Result<UnixListener> again =
      look.again->ok() ? take(*context_, std::move(**look.again)) : Result<UnixListener>(look.again->status());
  if (!again.ok()) {
    const std::string why = again.status().message();
    if (std::exchange(complaint_, why) != why)
      spdlog::error("the socket {} was removed and can't be made again: {}", path_, complaint_);
    return;
  }
  spdlog::warn("the socket {} was removed; it is made again", path_);
  complaint_.clear();
  close();
  listeners_.push_back(std::move(*again));
  accept_(listeners_.back().acceptor);
}

void LastingListener::close() {
  if (listeners_.empty()) return;
  error_code ignored;
  listeners_.back().name.remove();
  listeners_.back().acceptor.close(ignored);
}

Result<TcpAcceptor> listen_tcp(asio::io_context& context, const std::string& where, Network network) {
  const HostPort parts = split_host_port(where);
  const auto port = port_number(parts.port);
  if (!port || parts.host.empty())
    return Status(Code::invalid_argument, fmt::format("'{}' is not HOST:PORT", where), "for example 127.0.0.1:7470");
  error_code error;
  asio::ip::tcp::resolver resolver(context);
  const auto found = resolver.resolve(parts.host, std::to_string(*port), asio::ip::tcp::resolver::passive, error);
  if (error || found.empty())
    return Status(Code::invalid_argument, fmt::format("{}: no such host: {}", where, error.message()));
  const asio::ip::tcp::endpoint endpoint = found.begin()->endpoint();
  if (network == Network::loopback && !endpoint.address().is_loopback())
    return Status(
        Code::invalid_argument,
        fmt::format("{}: other machines reach {}, and this machine's OpenSSL can't encrypt what travels there", where,
                    endpoint.address().to_string()),
        "mend OpenSSL (the log has its reason), listen on 127.0.0.1 and reach it through a tunnel (ssh -L "
        "7470:127.0.0.1:7470 HOST), or say with --trusted-network that nobody on the network is to be feared");
  TcpAcceptor acceptor(context);
  acceptor.open(endpoint.protocol(), error);
  if (!error) acceptor.set_option(asio::socket_base::reuse_address(true), error);
  if (!error && endpoint.address().is_unspecified() && endpoint.address().is_v6())
    acceptor.set_option(asio::ip::v6_only(false), error);  // IPv4 too, whatever the system's default is
  if (!error) acceptor.bind(endpoint, error);
  if (!error) acceptor.listen(kBacklog, error);
  if (error == asio::error::address_in_use)
    return Status(Code::busy, fmt::format("{} is in use by another program", where),
                  "give the service another port, with --endpoint");
  if (error) return Status(Code::io_error, fmt::format("can't listen on {}: {}", where, error.message()));
  return acceptor;
}

std::string bound_address(const TcpAcceptor& acceptor) {
  error_code error;
  const asio::ip::tcp::endpoint endpoint = acceptor.local_endpoint(error);
  if (error) return "";
  return join_host_port(endpoint.address().to_string(), endpoint.port());
}

bool on_loopback(const TcpAcceptor& acceptor) {
  error_code error;
  const asio::ip::tcp::endpoint endpoint = acceptor.local_endpoint(error);
  return !error && !tls::off_loopback(*endpoint.data());
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
