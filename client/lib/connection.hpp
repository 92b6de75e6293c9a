// Connection: one socket to a service, frames out and in. Boost.Asio stays behind it.
//
// Invariants
// 1. Every wait ends at its deadline. After a wait that ended so the place in the stream is unknown, and the
//    connection counts as lost.
// 2. It reads while it writes, so a service that answers early and a client that still sends never wait for each
//    other.
// 3. Memory for an answer grows with the bytes that arrive, not with the length that the peer claims.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "client/lib/endpoint.hpp"
#include "common/base/status.hpp"
#include "common/wire/frame.hpp"
#include "common/wire/message.hpp"

namespace rcb::client {

class Deadline {
 public:
  using Clock = std::chrono::steady_clock;
  // Bounded to a day, so that no number given by a caller overflows the clock.
  explicit Deadline(double seconds);
  Clock::time_point at() const { return at_; }
  double left_seconds() const { return std::chrono::duration<double>(at_ - Clock::now()).count(); }
  // The earlier of this one and `seconds` from now.
  Deadline within(double seconds) const;

 private:
  Clock::time_point at_;
};

struct Frame {
  wire::FrameType type = wire::FrameType::reply;
  std::uint64_t request = 0;
  std::string text;  // the JSON, not parsed: some answers are large and only passed on
  std::vector<wire::Array> arrays;

  Result<wire::Json> json() const { return wire::parse_json(text, wire::kReplyJsonBytesMax, wire::kReplyJsonBytesMax); }
};

using Bytes = std::span<const std::byte>;
using NoticeHandler = std::function<void(const std::string&)>;

class Connection {
 public:
  // Errors: unavailable, deadline_exceeded, not_authorised (a socket that another user serves).
  static Result<std::unique_ptr<Connection>> open(const Endpoint& endpoint, const Deadline& deadline,
                                                  NoticeHandler on_notice);
  ~Connection();

  // Returns when all bytes are with the kernel. Errors: unavailable, deadline_exceeded, protocol_error.
  Status write(std::span<const Bytes> pieces, const Deadline& deadline);
  // The next frame that isn't a notice. Errors: as write.
  Result<Frame> read(const Deadline& deadline);
  // Something to read is there, or the connection was found lost; doesn't wait.
  bool has_news();
  // Why no more frames come; ok while they may.
  Status lost() const;
  // The connection was ended by the service's goodbye.
  bool said_goodbye() const;
  // The socket, for writing to it without this class; nothing else may be written meanwhile.
  int handle();
  // The peer's address is one of this machine's.
  bool this_machine() const;

 private:
  struct State;
  explicit Connection(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace rcb::client
