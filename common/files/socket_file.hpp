// Socket files: the file names of Unix sockets, which a killed process leaves behind.
#pragma once

#include <string>
#include <vector>

namespace rcb {

enum class SocketState {
  absent,
  dead,     // nobody listens: its process has ended
  live,     // somebody listens
  foreign,  // not a socket, another user's, or unknown
};

// Finds out by connecting; never blocks.
SocketState socket_state(const std::string& path);

// Removes those of the endpoint's socket and its ranks' sockets (PATH, PATH.0, PATH.1, ...) on which nobody listens,
// and returns them. The caller holds the endpoint's lock, and no process of its service runs.
std::vector<std::string> remove_dead_sockets(const std::string& path);

// Removes the sockets FOLDER/PREFIX* on which nobody listens, if they are older than a minute: a younger one may be
// another process's that is about to listen.
void remove_old_dead_sockets(const std::string& folder, const std::string& prefix);

}  // namespace rcb
