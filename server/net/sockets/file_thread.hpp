// FileThread: the thread on which files are touched on behalf of the I/O thread, which never does so itself: a disk may
// stand still, and heartbeats must not. Each io_context has one.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>

#include "common/base/status.hpp"
#include "common/files/side_thread.hpp"
#include "server/net/sockets/asio.hpp"

namespace rcb::net {

class FileThread : public asio::execution_context::service {
 public:
  using key_type = FileThread;
  static asio::execution_context::id id;
  static constexpr std::uint64_t kBytesMax = std::uint64_t{1}
                                             << 20U;  // that the jobs hold beside what others hold anyway

  explicit FileThread(asio::execution_context& context);
  static FileThread& of(asio::io_context& context) { return asio::use_service<FileThread>(context); }

  // Runs `work` on the thread, then `then` on the I/O thread. They own what they touch, as the context may be gone
  // before a disk answers; then no `then` is run. Errors: busy, unavailable (there is no thread).
  Status run(std::function<void()> work, std::function<void()> then);
  // When the loop has stopped: ends the thread when it has done what waits, or in a moment (SideThread). run() fails
  // then.
  void finish() { thread_.reset(); }

 private:
  void shutdown() override { finish(); }

  asio::io_context& context_;
  std::optional<SideThread> thread_;
};

}  // namespace rcb::net
