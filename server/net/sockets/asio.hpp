// The parts of Asio that this folder uses, under short names. Slow to compile: include it only where needed.
#pragma once

#include <chrono>

#include <boost/asio/as_tuple.hpp>
#include <boost/asio/awaitable.hpp>
#include <boost/asio/co_spawn.hpp>
#include <boost/asio/detached.hpp>
#include <boost/asio/generic/stream_protocol.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/network_v4.hpp>
#include <boost/asio/ip/network_v6.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/ip/v6_only.hpp>
#include <boost/asio/local/stream_protocol.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/signal_set.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/use_awaitable.hpp>

namespace rcb::net {

namespace asio = boost::asio;
using asio::awaitable;
using boost::system::error_code;
using Socket = asio::generic::stream_protocol::socket;
using Timer = asio::steady_timer;
using TimePoint = std::chrono::steady_clock::time_point;

// Errors are returned as values: auto [error, bytes] = co_await ...(kAwait).
inline constexpr auto kAwait = asio::as_tuple(asio::use_awaitable);

inline TimePoint now() { return std::chrono::steady_clock::now(); }
inline std::chrono::steady_clock::duration duration_of(double seconds) {
  return std::chrono::duration_cast<std::chrono::steady_clock::duration>(std::chrono::duration<double>(seconds));
}
inline double seconds_since(TimePoint start) { return std::chrono::duration<double>(now() - start).count(); }

}  // namespace rcb::net
