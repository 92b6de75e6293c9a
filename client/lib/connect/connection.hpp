// Room `connect`: where a service is, one connection to it, and how long a call tries again. Frames in and out; nothing
// here knows a command.
//
// Connection: one socket to a service, encrypted or not, frames out and in. Hides Boost.Asio.
//
// Invariants
// 1. Every wait ends at its deadline. After a timeout the position in the byte stream is unknown, so the connection
//    counts as lost.
// 2. It reads while it writes, so that a service that answers early and a client that still sends never block each
//    other.
// 3. Memory for an answer grows with the bytes that arrive, not with the length that the peer announces.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <sys/uio.h>

#include "client/lib/connect/endpoint.hpp"
#include "common/base/status.hpp"
#include "common/wire/frame.hpp"
#include "common/wire/message.hpp"

namespace rcb::client {

class Deadline {
 public:
  using Clock = std::chrono::steady_clock;
  // Limited to a day, so that no number given by a caller overflows the clock.
  explicit Deadline(double seconds);
  Clock::time_point at() const { return at_; }
  double left_seconds() const { return std::chrono::duration<double>(at_ - Clock::now()).count(); }
  // The earlier of this deadline and `seconds` from now.
  Deadline within(double seconds) const;

 private:
  Clock::time_point at_;
};

struct Frame {
  wire::FrameType type = wire::FrameType::reply;
  std::uint64_t request = 0;
  std::string text;  // JSON, not parsed: some answers are large and only passed on
  std::vector<wire::Array> arrays;

  // The elements of an array; nothing if it isn't there, or has another type.
  template <typename T>
  std::optional<std::span<const T>> array(const char* name) const {
    const wire::Array* const found = wire::find_array(arrays, name);
    if (found == nullptr || found->dtype != wire::dtype_of<T>()) return std::nullopt;
    return std::span(reinterpret_cast<const T*>(found->bytes.data()), found->bytes.size() / sizeof(T));
  }
  Result<wire::Json> json() const { return wire::parse_json(text, wire::kReplyJsonBytesMax, wire::kReplyJsonBytesMax); }
};

// Parsed once, since an answer comes at each step.
struct Answer {
  explicit Answer(Frame told) : frame(std::move(told)), json(frame.json()) {}
  Frame frame;
  Result<wire::Json> json;
};

using Bytes = std::span<const std::byte>;
using NoticeHandler = std::function<void(const std::string&)>;
using WaitHandler = std::function<bool()>;  // ConnectOptions::on_wait

// The hint of an `unavailable` whose cause is this process's own limit for open files.
inline constexpr const char* kDescriptorsHint = "close files, or raise the limit: ulimit -n";

class Connection {
 public:
  // Nothing is said yet. Errors: unavailable, deadline_exceeded, not_authorised (another user serves the socket).
  // Each wait also ends when `on_wait` says so, with the error `interrupted`; the connection is lost then.
  static Result<std::unique_ptr<Connection>> open(const Endpoint& endpoint, const Deadline& deadline,
                                                  NoticeHandler on_notice, WaitHandler on_wait);
  ~Connection();

  // Whether it leads to an address of TCP that isn't loopback, hence perhaps to another machine.
  bool off_loopback() const;
  // Before anything else is said: speaks TLS from here on. Errors: protocol_error (the peer doesn't), unavailable,
  // deadline_exceeded.
  Status encrypt(const Deadline& deadline);
  // The fingerprint of the certificate that the peer has shown; empty: the connection isn't encrypted.
  std::string certificate() const;

  // Returns when the kernel has taken all bytes. Errors: unavailable, deadline_exceeded, protocol_error.
  Status write(std::span<const Bytes> pieces, const Deadline& deadline);
  Status write(const std::string& frames, const Deadline& deadline);
  // The next frame that isn't a notice. Errors: those of write().
  Result<Frame> read(const Deadline& deadline);
  // Waits until a frame can be read or the connection is lost; false at the deadline, which costs nothing.
  bool await_frame(const Deadline& deadline);
  // Whether a frame can be read or the connection is lost; doesn't wait.
  bool has_frame();
  // Why no more frames can come; ok while the connection stands.
  Status lost() const;
  // Whether the service ended the connection with a goodbye.
  bool said_goodbye() const;
  // Sends as much of the pieces as the socket has room for, and returns how many bytes that is. The next call must go
  // on from there; write() must not be used meanwhile. Errors: unavailable.
  Result<std::size_t> send_some(std::span<const iovec> pieces);
  // The socket, to wait for room.
  int handle();
  // Sends a short frame over a Unix socket, with a descriptor unless that is -1, without waiting for room. write() must
  // not be in use. Errors: unavailable.
  Status send_at_once(Bytes frame, int descriptor);
  // Whether the peer's address is one of this machine.
  bool this_machine() const;

 private:
  struct State;
  explicit Connection(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace rcb::client
