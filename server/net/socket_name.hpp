// SocketName: the name of a listening Unix socket in the file system, removed by the process that it belongs to.
//
// Invariants
// 1. A file that stands at the path by now, but isn't the socket that was bound, stays. (As long as the socket is open
//    the file system doesn't give its number to another, so a name is to be removed before its socket is closed.)
// 2. remove_all() may be called at any moment, in a signal handler too.
#pragma once

#include <string>

namespace rcb::net {

class SocketName {
 public:
  SocketName() = default;
  // path: has just been bound by this process.
  explicit SocketName(const std::string& path);
  SocketName(SocketName&& other) noexcept;
  SocketName& operator=(SocketName&& other) noexcept;
  ~SocketName();

  void remove();
  // The socket that was bound still has this name.
  bool in_place() const;

  // Those of all objects of this process, which is about to end.
  static void remove_all() noexcept;

 private:
  int slot_ = -1;  // in the process's table
};

}  // namespace rcb::net
