// Listening sockets: the control sockets of rank 0.
//
// Invariants
// 1. A socket on which a live service answers is never taken; a stale one is replaced.
// 2. A Unix socket is 0600 from the moment it exists.
#pragma once

#include <string>

#include "common/base/status.hpp"
#include "server/net/asio.hpp"

namespace rcb::net {

using UnixAcceptor = asio::local::stream_protocol::acceptor;
using TcpAcceptor = asio::ip::tcp::acceptor;

// Errors: invalid_argument (path too long), busy (a live service), io_error, not_authorised.
Result<UnixAcceptor> listen_unix(asio::io_context& context, const std::string& path);
// where: HOST:PORT or [V6]:PORT; port 0 takes a free one. Errors: invalid_argument, busy, io_error.
Result<TcpAcceptor> listen_tcp(asio::io_context& context, const std::string& where);
// "127.0.0.1:7470", as it was bound.
std::string bound_address(const TcpAcceptor& acceptor);

// The peer's user of a Unix socket. Errors: not_authorised unless it is this process's user or root.
Status check_peer_user(int socket);

}  // namespace rcb::net
