// A peer on another machine may vanish without a word: its power fails, or its network. What TCP does by itself takes
// hours to notice that.
#pragma once

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>

namespace rcb {

inline constexpr int kPeerGoneSeconds = 60;

// Ends the connection when the peer has given no sign of life for about kPeerGoneSeconds: neither to a word that was
// sent nor, where nothing is sent, to the kernel's own questions. unread_seconds: how long the peer may leave unread
// what was sent to it, alive as it is. Not a TCP socket: nothing.
inline void end_with_vanished_peer(int socket, int unread_seconds = kPeerGoneSeconds) {
  const auto set = [socket](int level, int name, int value) {
    static_cast<void>(::setsockopt(socket, level, name, &value, sizeof(value)));
  };
  constexpr int kBetweenSeconds = 10;
  constexpr int kQuestions = 4;
  set(SOL_SOCKET, SO_KEEPALIVE, 1);
  set(IPPROTO_TCP, TCP_KEEPIDLE, kPeerGoneSeconds - kQuestions * kBetweenSeconds);
  set(IPPROTO_TCP, TCP_KEEPINTVL, kBetweenSeconds);
  set(IPPROTO_TCP, TCP_KEEPCNT, kQuestions);
  set(IPPROTO_TCP, TCP_USER_TIMEOUT, unread_seconds * 1000);
}

}  // namespace rcb
