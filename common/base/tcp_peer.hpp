// TCP keep-alive: ends a connection whose peer on another machine has vanished without a word, since its power or its
// network failed. By itself TCP takes hours to notice that.
#pragma once

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>

namespace rcb {

inline constexpr int kPeerGoneSeconds = 60;
// For the service's connections to clients. A solver whose machine has vanished holds its scene for so long; the one
// that is started in its place waits for the scene for twice as long.
inline constexpr int kClientGoneSeconds = 30;

// Ends the connection when for about gone_seconds the peer has neither acknowledged what was sent nor answered a
// keep-alive probe. unread_seconds: how long a peer that lives may leave unread what was sent to it; no less. Without
// effect on other sockets.
inline void set_keep_alive(int socket, int gone_seconds, int unread_seconds) {
  const auto set = [socket](int level, int name, int value) {
    static_cast<void>(::setsockopt(socket, level, name, &value, sizeof(value)));
  };
  constexpr int kProbes = 4;
  const int between_seconds = gone_seconds / 6;
  set(SOL_SOCKET, SO_KEEPALIVE, 1);
  set(IPPROTO_TCP, TCP_KEEPIDLE, gone_seconds - kProbes * between_seconds);
  set(IPPROTO_TCP, TCP_KEEPINTVL, between_seconds);
  set(IPPROTO_TCP, TCP_KEEPCNT, kProbes);
  set(IPPROTO_TCP, TCP_USER_TIMEOUT, unread_seconds * 1000);
}

}  // namespace rcb
