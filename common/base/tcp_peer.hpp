// TCP keep-alive: ends a connection whose peer on another machine has vanished without a word, since its power or its
// network failed. By itself TCP takes hours to notice that.
#pragma once

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>

namespace rcb {

inline constexpr int kPeerGoneSeconds = 60;

// Ends the connection when for about kPeerGoneSeconds the peer has neither acknowledged what was sent nor answered a
// keep-alive probe. unread_seconds: how long a peer that lives may leave unread what was sent to it. Without effect on
// other sockets.
inline void set_keep_alive(int socket, int unread_seconds = kPeerGoneSeconds) {
  const auto set = [socket](int level, int name, int value) {
    static_cast<void>(::setsockopt(socket, level, name, &value, sizeof(value)));
  };
  constexpr int kBetweenSeconds = 10;
  constexpr int kProbes = 4;
  set(SOL_SOCKET, SO_KEEPALIVE, 1);
  set(IPPROTO_TCP, TCP_KEEPIDLE, kPeerGoneSeconds - kProbes * kBetweenSeconds);
  set(IPPROTO_TCP, TCP_KEEPINTVL, kBetweenSeconds);
  set(IPPROTO_TCP, TCP_KEEPCNT, kProbes);
  set(IPPROTO_TCP, TCP_USER_TIMEOUT, unread_seconds * 1000);
}

}  // namespace rcb
