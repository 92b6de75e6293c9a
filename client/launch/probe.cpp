#include "client/launch/probe.hpp"

#include <cerrno>
#include <cstring>
#include <memory>

#include <netdb.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "client/lib/connect/endpoint.hpp"
#include "common/base/clock.hpp"

namespace rcb::launch {
namespace {

// Waits for the events, or for an error. False after a timeout.
bool await(int socket, short events, double seconds) {
  pollfd fd{socket, events, 0};
  return ::poll(&fd, 1, static_cast<int>(1000 * seconds) + 1) > 0;
}

bool connects_and_hears(int family, const sockaddr* address, socklen_t bytes, double deadline_seconds) {
  const SteadyClock clock;
  const double end = clock.seconds() + deadline_seconds;
  const int socket = ::socket(family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  if (socket < 0) return false;
  bool record_probe = ::connect(socket, address, bytes) == 0;
  if (!record_probe && errno == EINPROGRESS && await(socket, POLLOUT, deadline_seconds)) {
    int fault = 0;
    socklen_t size = sizeof fault;
    record_probe = ::getsockopt(socket, SOL_SOCKET, SO_ERROR, &fault, &size) == 0 && fault == 0;
  }
  // A listener that encrypts waits for its client's first byte. It answers one that isn't TLS's at once, and any other
  // listener has spoken already.
  if (record_probe && family != AF_UNIX) record_probe = ::send(socket, "R", 1, MSG_NOSIGNAL) == 1;
  record_probe = record_probe && await(socket, POLLIN, end - clock.seconds());
  ::close(socket);
  return record_probe;
}

bool answers_on_unix(const std::string& path, double deadline_seconds) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (path.size() >= sizeof address.sun_path) return false;
  std::memcpy(address.sun_path, path.data(), path.size());
  return connects_and_hears(AF_UNIX, reinterpret_cast<const sockaddr*>(&address), sizeof address, deadline_seconds);
}

bool answers_on_tcp(const client::Endpoint& endpoint, double deadline_seconds) {
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (::getaddrinfo(endpoint.host.c_str(), std::to_string(endpoint.port).c_str(), &hints, &found) != 0) return false;
  const std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)> list(found, ::freeaddrinfo);
  for (const addrinfo* entry = found; entry != nullptr; entry = entry->ai_next)
    if (connects_and_hears(entry->ai_family, entry->ai_addr, entry->ai_addrlen, deadline_seconds)) return true;
  return false;
}

}  // namespace

bool answers(const std::string& endpoint, double deadline_seconds) {
  const auto parsed = client::parse_endpoint(endpoint);
  if (!parsed.ok()) return false;
  return parsed->is_unix ? answers_on_unix(parsed->path, deadline_seconds) : answers_on_tcp(*parsed, deadline_seconds);
}

}  // namespace rcb::launch
