#include "client/launch/probe.hpp"

#include <cerrno>
#include <cstring>
#include <memory>

#include <netdb.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>

#include "client/lib/connect/endpoint.hpp"
#include "common/base/clock.hpp"
#include "common/files/descriptor.hpp"

namespace rcb::launch {
namespace {

// Waits for the events, or for an error. False after a timeout.
bool await(int socket, short events, double seconds) {
  pollfd fd{socket, events, 0};
  return ::poll(&fd, 1, static_cast<int>(1000 * seconds) + 1) > 0;
}

// Whether a connection that failed like this tells of the listener; else of this process or of the way to it.
bool tells_of_listener(int fault) {
  for (const int known : {ECONNREFUSED, ENOENT, EAGAIN, ETIMEDOUT, ECONNRESET, EPIPE})
    if (fault == known) return true;
  return false;
}

Answer failed(int fault, std::string& why) {
  if (tells_of_listener(fault)) return Answer::silent;
  why = std::strerror(fault);
  return Answer::unasked;
}

Answer ask_at(int family, const sockaddr* address, socklen_t bytes, double deadline_seconds, std::string& why) {
  const SteadyClock clock;
  const double end = clock.seconds() + deadline_seconds;
  const Descriptor socket(::socket(family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!socket.open()) return failed(errno, why);
  if (::connect(socket.get(), address, bytes) != 0) {
    if (errno != EINPROGRESS) return failed(errno, why);
    if (!await(socket.get(), POLLOUT, deadline_seconds)) return Answer::silent;
    int fault = 0;
    socklen_t size = sizeof fault;
    if (::getsockopt(socket.get(), SOL_SOCKET, SO_ERROR, &fault, &size) != 0) fault = errno;
    if (fault != 0) return failed(fault, why);
  }
  // A listener that encrypts waits for its client's first byte. It answers one that isn't TLS's at once, and any other
  // listener has spoken already.
  if (family != AF_UNIX && ::send(socket.get(), "R", 1, MSG_NOSIGNAL) != 1) return failed(errno, why);
  return await(socket.get(), POLLIN, end - clock.seconds()) ? Answer::heard : Answer::silent;
}

Answer ask_unix(const std::string& path, double deadline_seconds, std::string& why) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (path.size() >= sizeof address.sun_path) return failed(ENAMETOOLONG, why);
  std::memcpy(address.sun_path, path.data(), path.size());
  return ask_at(AF_UNIX, reinterpret_cast<const sockaddr*>(&address), sizeof address, deadline_seconds, why);
}

Answer ask_tcp(const client::Endpoint& endpoint, double deadline_seconds, std::string& why) {
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  const int fault = ::getaddrinfo(endpoint.host.c_str(), std::to_string(endpoint.port).c_str(), &hints, &found);
  if (fault != 0) {
    why = ::gai_strerror(fault);
    return Answer::unasked;
  }
  const std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)> list(found, ::freeaddrinfo);
  Answer answer = Answer::unasked;
  for (const addrinfo* entry = found; entry != nullptr; entry = entry->ai_next) {
    const Answer one = ask_at(entry->ai_family, entry->ai_addr, entry->ai_addrlen, deadline_seconds, why);
    if (one == Answer::heard) return one;
    if (one == Answer::silent) answer = one;
  }
  return answer;
}

}  // namespace

Answer ask(const std::string& endpoint, double deadline_seconds, std::string& why) {
  const auto parsed = client::parse_endpoint(endpoint);
  if (!parsed.ok()) {
    why = parsed.status().message();
    return Answer::unasked;
  }
  return parsed->is_unix ? ask_unix(parsed->path, deadline_seconds, why) : ask_tcp(*parsed, deadline_seconds, why);
}

}  // namespace rcb::launch
