// The names of Unix sockets in the file system, which a process that was killed leaves behind.
#pragma once

#include <string>
#include <vector>

namespace rcb {

enum class SocketState {
  absent,
  dead,     // nobody listens: its process has ended
  live,     // somebody listens
  foreign,  // no socket, another user's, or it can't be told
};

// Asks by connecting; never waits.
SocketState socket_state(const std::string& path);

// The endpoint's socket and its ranks' (PATH, PATH.0, PATH.1, ...) on which nobody listens are removed. To be called by
// whoever has the endpoint's lock, while nothing of it runs. Returns what was removed.
std::vector<std::string> remove_dead_sockets(const std::string& path);

}  // namespace rcb
