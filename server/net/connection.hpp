// Connection: frames over one stream socket, with a limit and a deadline on everything a peer can do.
//
// Invariants
// 1. One coroutine reads. Any code on the I/O thread may send; a writer coroutine lives only while there is work.
// 2. Between two bytes of a frame, and between two bytes that the peer takes, at most `frame_seconds` pass; then the
//    connection is closed. Between frames it may be silent for ever, and then no timer is armed.
// 3. After an error every read fails at once and send() does nothing.
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/wire/frame.hpp"
#include "common/wire/message.hpp"
#include "server/net/asio.hpp"
#include "server/net/large_json.hpp"

namespace rcb::net {

struct Frame {
  wire::FrameHeader header;
  wire::Json json;
  LargeJson::Place place = nullptr;  // of a large JSON, to be kept as long as it is
  // header.bulk_bytes (and 8 more with kFlagBulkChecksum) are still to be read.
};

class Connection : public std::enable_shared_from_this<Connection> {
 public:
  Connection(Socket socket, double frame_seconds);

  // The next frame up to its JSON. Errors: unavailable (the peer is gone; message "" where it closed between two
  // frames), protocol_error, too_large, deadline_exceeded.
  awaitable<Result<Frame>> read_frame(std::uint64_t json_bytes_max, std::uint64_t bulk_bytes_max);
  awaitable<Status> read_bulk(std::span<std::byte> into);
  // Reads the rest of a frame and forgets it: `bytes` of bulk, then the checksum if there is one.
  awaitable<Status> skip_bulk(const Frame& frame, std::uint64_t bytes);

  // Until this moment all reading must be done; TimePoint::max() ends the rule.
  void limit_reading(TimePoint end);

  // held: given up once the message is sent or never will be. Errors: internal (nothing is sent).
  Status send_message(wire::FrameType type, std::uint64_t request, wire::Json json, std::vector<wire::Array> arrays,
                      std::shared_ptr<void> held = nullptr);
  // For messages of ours that are short.
  void send(wire::FrameType type, std::uint64_t request, const wire::Json& json);
  void send_text(wire::FrameType type, std::uint64_t request, const std::string& json);
  // Waits until everything is sent or the connection is broken.
  awaitable<void> flush();
  // Sends what is queued, then closes so that the peer can still read it (a plain close with unread input would
  // make the kernel throw it away): waits, for a second at most, for the peer to close.
  awaitable<void> end_gently();
  void close();
  // Closes at once; the peer is told why where its socket has room.
  void close_saying(const Status& why);
  // Whether the peer has closed its sending side, however much of what it sent is still unread.
  bool peer_has_gone();
  // Whether nobody can receive what is sent any more, as far as that is known without sending.
  bool peer_is_lost();
  std::uint64_t bytes_received() const { return bytes_received_; }
  bool broken() const { return broken_; }
  Socket& socket() { return socket_; }

 private:
  struct Outgoing {
    std::string head;
    std::vector<wire::Array> arrays;
    std::shared_ptr<void> held = nullptr;
  };

  awaitable<Status> read_exactly(std::span<std::byte> into);
  awaitable<Status> read_text(std::string& text, std::size_t bytes);
  awaitable<Status> refill();
  awaitable<void> write_all();
  awaitable<bool> write_span(std::span<const std::byte> bytes);
  Status read_failed(const error_code& error) const;
  bool polled(short events);
  void enqueue(Outgoing outgoing);
  void touch_reading() { read_end_ = now() + frame_time_; }
  void arm();

  Socket socket_;
  std::chrono::steady_clock::duration frame_time_;
  Timer watch_;
  TimePoint watch_at_ = TimePoint::max();
  TimePoint read_end_ = TimePoint::max();   // moves with every byte
  TimePoint limit_end_ = TimePoint::max();  // doesn't
  TimePoint write_end_ = TimePoint::max();
  bool read_late_ = false;
  bool broken_ = false;
  bool writing_ = false;
  std::deque<Outgoing> queue_;
  std::vector<Timer*> flushing_;
  std::array<std::byte, 16384> inbox_;
  std::size_t inbox_begin_ = 0;
  std::size_t inbox_end_ = 0;
  std::uint64_t bytes_received_ = 0;
};

}  // namespace rcb::net
