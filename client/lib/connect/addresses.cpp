#include "client/lib/connect/addresses.hpp"

#include <cerrno>
#include <condition_variable>
#include <cstring>
#include <memory>
#include <mutex>
#include <system_error>
#include <thread>

#include <boost/asio/ip/address.hpp>
#include <boost/asio/local/stream_protocol.hpp>
#include <fmt/format.h>
#include <netdb.h>
#include <sys/socket.h>
#include <unistd.h>

#include "common/base/signals.hpp"

namespace rcb::client {
namespace {

// The addresses of a host name. Looked up in a thread, since getaddrinfo has no deadline; a look-up that outlasts the
// deadline is abandoned and touches nothing but its own shared state.
Result<std::vector<Address>> look_up_name(const Endpoint& endpoint, const Deadline& deadline) {
  struct LookUp {
    std::mutex mutex;
    std::condition_variable done;
    bool finished = false;
    int error = 0;
    std::vector<Address> found;
  };
  const auto look_up = std::make_shared<LookUp>();
  const auto work = [look_up, host = endpoint.host, port = fmt::format("{}", endpoint.port)] {
    addrinfo hints{};
    hints.ai_socktype = SOCK_STREAM;
    hints.ai_flags = AI_NUMERICSERV;
    addrinfo* list = nullptr;
    const int error = ::getaddrinfo(host.c_str(), port.c_str(), &hints, &list);
    const std::lock_guard lock(look_up->mutex);
    look_up->error = error;
    for (const addrinfo* entry = list; entry != nullptr; entry = entry->ai_next)
      look_up->found.emplace_back(entry->ai_addr, entry->ai_addrlen, IPPROTO_TCP);
    if (list != nullptr) ::freeaddrinfo(list);
    look_up->finished = true;
    look_up->done.notify_all();
  };
  boost::system::error_code not_numeric;
  boost::asio::ip::make_address(endpoint.host, not_numeric);
  if (!not_numeric) {
    work();
  } else {
    try {
      const SignalsBlocked blocked;
      std::thread(work).detach();
    } catch (const std::system_error& none) {
      return Status(Code::unavailable,
                    fmt::format("the name '{}' can't be looked up: no thread: {}", endpoint.host, none.what()),
                    "see ulimit -u, or give the address as numbers");
    }
  }
  std::unique_lock lock(look_up->mutex);
  if (!look_up->done.wait_until(lock, deadline.at(), [&] { return look_up->finished; }))
    return Status(Code::deadline_exceeded, fmt::format("the name '{}' could not be looked up in time", endpoint.host));
  if (look_up->found.empty())
    return Status(Code::unavailable,
                  fmt::format("the name '{}' has no address: {}", endpoint.host, ::gai_strerror(look_up->error)));
  return look_up->found;
}

}  // namespace

Result<std::vector<Address>> addresses_of(const Endpoint& endpoint, const Deadline& deadline) {
  if (!endpoint.is_unix) return look_up_name(endpoint, deadline);
  return std::vector<Address>{boost::asio::local::stream_protocol::endpoint(endpoint.path)};
}

Status check_server(int handle, const Endpoint& endpoint) {
  ucred peer{};
  socklen_t size = sizeof peer;
  if (::getsockopt(handle, SOL_SOCKET, SO_PEERCRED, &peer, &size) != 0)
    return {Code::not_authorised, fmt::format("can't tell who serves {}: {}", endpoint.text(), std::strerror(errno))};
  if (peer.uid == ::geteuid() || peer.uid == 0 || ::geteuid() == 0) return {};
  return {Code::not_authorised,
          fmt::format("{} is served by user {}, not by this one ({})", endpoint.text(), peer.uid, ::geteuid()),
          "name the endpoint of a service of your own"};
}

}  // namespace rcb::client
