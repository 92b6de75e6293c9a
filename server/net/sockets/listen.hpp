// Listening sockets: the control sockets of rank 0, every rank's data sockets.
//
// Invariants
// 1. A socket on which a live service answers is never taken; a stale one is replaced. The service at an endpoint holds
//    its lock (endpoint_lock.hpp), so that two services that find the same stale socket don't remove each other's.
// 2. A Unix socket has mode 0600 from the moment it exists.
#pragma once

#include <functional>
#include <list>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>

#include <spdlog/spdlog.h>

#include "common/base/status.hpp"
#include "common/base/tcp_peer.hpp"
#include "server/net/files/socket_name.hpp"
#include "server/net/sockets/asio.hpp"
#include "server/net/sockets/credentials.hpp"

namespace rcb::net {

using UnixAcceptor = asio::local::stream_protocol::acceptor;
using TcpAcceptor = asio::ip::tcp::acceptor;

struct UnixListener {
  UnixAcceptor acceptor;
  SocketName name;  // destroyed before the acceptor, whose end frees the inode
};
// Errors: invalid_argument (path too long), busy (a live service), io_error.
Result<UnixListener> listen_unix(asio::io_context& context, const std::string& path);
// A Unix socket that is made anew if somebody removes its name.
class LastingListener {
 public:
  // Errors: those of listen_unix.
  Status listen(asio::io_context& context, const std::string& path);
  // accept: is called for this socket and every later one, to take connections from it; an acceptor lives as long as
  // this object.
  void start(std::function<void(UnixAcceptor&)> accept);
  // To be called periodically: makes the socket anew if its name is gone; on the thread of the files, since the
  // socket's disk may stand still. After close() it does nothing.
  void look();
  void close();

 private:
  struct Look;
  void found(Look& look);

  asio::io_context* context_ = nullptr;
  std::string path_;
  std::function<void(UnixAcceptor&)> accept_;
  std::list<UnixListener> listeners_;  // the last one is open; accept loops refer to the older ones
  std::string complaint_;
  bool looking_ = false;                                  // a look hasn't ended
  std::shared_ptr<int> there_ = std::make_shared<int>();  // whose end tells a look that this object has gone
};

// where: HOST:PORT or [V6]:PORT; port 0 takes a free one. Errors: invalid_argument (also if other machines could reach
// it and nothing protects what they say), busy, io_error.
Result<TcpAcceptor> listen_tcp(asio::io_context& context, const std::string& where, Network network);
// The address that was bound, as "127.0.0.1:7470".
std::string bound_address(const TcpAcceptor& acceptor);
// Whether it listens at a loopback address.
bool on_loopback(const TcpAcceptor& acceptor);

// Checks the user at the other end of a Unix socket. Errors: not_authorised unless it is this process's user or root.
Status check_peer_user(int socket);

// Takes connections until the acceptor is closed: calls take(Socket, Status), where the Status is that of
// check_peer_user(); ok over TCP.
template <typename Acceptor, typename Take>
awaitable<void> accept_all(asio::io_context& context, Acceptor& acceptor, Take take) {
  while (true) {
    typename Acceptor::protocol_type::socket socket(context);
    auto [error] = co_await acceptor.async_accept(socket, kAwait);
    if (error == asio::error::operation_aborted || !acceptor.is_open()) co_return;
    if (error) {  // most likely no file descriptors are left: pause, without harm to the connected clients
      spdlog::warn("a connection couldn't be taken: {}", error.message());
      Timer pause(context, std::chrono::milliseconds(200));
      co_await pause.async_wait(kAwait);
      continue;
    }
    if constexpr (std::is_same_v<Acceptor, TcpAcceptor>) {
      error_code ignored;
      socket.set_option(asio::ip::tcp::no_delay(true), ignored);
      set_keep_alive(socket.native_handle(), kClientGoneSeconds, kClientGoneSeconds);
    }
    Status peer;
    if constexpr (std::is_same_v<Acceptor, UnixAcceptor>) peer = check_peer_user(socket.native_handle());
    take(Socket(std::move(socket)), std::move(peer));
  }
}

}  // namespace rcb::net
