// SocketName: the name of a listening Unix socket in the file system, removed by the process that bound it.
//
// Invariants
// 1. A file that has replaced the socket at the path isn't removed. It is told by its inode, which the file system
//    doesn't reuse while the socket is open: so remove the name before closing the socket.
// 2. remove_all() may be called at any moment, also in a signal handler.
#pragma once

#include <cstdint>
#include <string>

namespace rcb::net {

// A socket's place in the file system.
struct SocketPlace {
  std::string path;
  std::uint64_t device = 0;
  std::uint64_t inode = 0;  // 0: none
  // Whether the path still names that socket.
  bool taken() const;
};

class SocketName {
 public:
  SocketName() = default;
  // path: of a socket that this process has just bound.
  explicit SocketName(const std::string& path);
  SocketName(SocketName&& other) noexcept;
  ~SocketName();

  void remove();
  // Where the socket was bound.
  SocketPlace place() const;

  // Removes the names of all objects of this process, which is about to end.
  static void remove_all() noexcept;

 private:
  int slot_ = -1;  // in the table of the process; -1: none
};

}  // namespace rcb::net
