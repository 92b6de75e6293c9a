// Room `sockets`: listeners, connections, the hello and the I/O loop. Converts bytes to frames and back, with a limit
// on everything. Other rooms use Asio through asio.hpp alone.
//
// Connection: frames over one stream socket, encrypted or not, with a limit and a deadline on everything a peer can do.
//
// Invariants
// 1. One coroutine reads. Any code on the I/O thread may send; a writer coroutine lives only while there is something
//    to send.
// 2. Within a frame at most `frame_seconds` pass between two bytes received, and likewise between two bytes that the
//    peer takes; then the connection is closed. Between frames the peer may be silent for ever; no timer runs then.
// 3. After an error every read fails at once and send() does nothing.
// 4. Once it is encrypted nothing is sent or taken without TLS.
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/files/descriptor.hpp"
#include "common/tls/stream.hpp"
#include "common/wire/frame.hpp"
#include "common/wire/message.hpp"
#include "server/net/sockets/asio.hpp"
#include "server/net/sockets/large_json.hpp"

namespace rcb::net {

struct Frame {
  wire::FrameHeader header;
  wire::Json json;
  // The bulk (header.bulk_bytes, and 8 more with kFlagBulkChecksum) is still to be read.
};

class Connection : public std::enable_shared_from_this<Connection> {
 public:
  Connection(Socket socket, double frame_seconds);

  // Whether the peer may be on another machine: the address that it has reached here is one of TCP, and not of
  // loopback.
  bool off_loopback() const;
  // Before anything else is said: speaks TLS from here on. The peer has until `end`, and must begin in the first half
  // of that time, so that one who waits for a word without TLS hears why before it gives up. Errors: protocol_error,
  // where the peer speaks without TLS or not at all, and can be told so without TLS; unavailable, where TLS has failed:
  // the connection is closed.
  awaitable<Status> encrypt(const tls::Identity& identity, TimePoint end);
  // The fingerprint of the certificate that the peer was shown; empty: the connection isn't encrypted.
  std::string certificate() const { return tls_ ? tls_->certificate() : ""; }

  // Reads the next frame up to the end of its JSON. Errors: unavailable (the peer is gone; the message is "" if it
  // closed between two frames), protocol_error, too_large, deadline_exceeded.
  awaitable<Result<Frame>> read_frame(std::uint64_t json_bytes_max, std::uint64_t bulk_bytes_max);
  // Whether some of a frame has come, and read_frame() hasn't returned it yet.
  bool reading_message() const { return reading_message_; }
  awaitable<Status> read_bulk(std::span<std::byte> into);
  // Reads and drops the rest of a frame: `bytes` of bulk, then the checksum if there is one.
  awaitable<Status> skip_bulk(const Frame& frame, std::uint64_t bytes);

  // On a Unix socket: from here on keeps the descriptors that the peer sends with a frame. They come with its first
  // byte.
  void accept_descriptors() { accepts_descriptors_ = true; }
  // The oldest descriptor that came and wasn't taken yet; not open: there is none.
  Descriptor take_descriptor();
  // Closes those that came with what has been read so far and that nobody has taken.
  void close_descriptors_read();

  // All reading must be done by `end`, or it fails; TimePoint::max() lifts the limit.
  void limit_reading(TimePoint end);

  // held: released when the message is sent or never will be. Errors: internal (nothing is sent).
  Status send_message(wire::FrameType type, std::uint64_t request, wire::Json json, std::vector<wire::Array> arrays,
                      std::shared_ptr<void> held = nullptr);
  // For short messages of the service itself.
  void send(wire::FrameType type, std::uint64_t request, const wire::Json& json);
  // For what others are sent as well: the JSON's text, which describes the arrays.
  void send_text(wire::FrameType type, std::uint64_t request, const std::string& json,
                 std::shared_ptr<const std::vector<wire::Array>> arrays = nullptr,
                 std::shared_ptr<void> held = nullptr);
  // Waits until everything is sent or the connection is broken.
  awaitable<void> flush();
  // A whole frame that others send as well.
  void send_shared(std::shared_ptr<const std::string> frame);
  // Sends what is queued, then closes so that the peer can still read it: a plain close with unread input would make
  // the kernel discard it. So it waits, for a second at most, until the peer closes.
  awaitable<void> end_gently();
  void close();
  // Closes when the peer has been told why, or a second later if its socket has no room.
  void close_saying(const Status& why);
  // Whether the peer has closed its sending side, even if data it sent before is still unread.
  bool peer_has_gone();
  // Whether it is known, without sending, that nobody can receive any more.
  bool peer_is_lost();
  std::uint64_t bytes_received() const { return bytes_received_; }
  bool broken() const { return broken_; }
  Socket& socket() { return socket_; }

 private:
  struct Outgoing {
    std::string head;
    std::shared_ptr<const std::vector<wire::Array>> arrays = nullptr;
    std::shared_ptr<void> held = nullptr;
    std::shared_ptr<const std::string> frame = nullptr;  // instead of `head`
  };

  // The rest of a frame of which something has come.
  awaitable<Result<Frame>> read_message(std::uint64_t json_bytes_max, std::uint64_t bulk_bytes_max);
  awaitable<Status> read_exactly(std::span<std::byte> into);
  awaitable<Status> read_text(std::string& text, std::size_t bytes);
  awaitable<Status> refill();
  // Like async_read_some and async_write_some, with TLS. Both end when no byte more can be moved without waiting.
  awaitable<std::pair<error_code, std::size_t>> read_encrypted(std::span<std::byte> into);
  awaitable<std::pair<error_code, std::size_t>> write_encrypted(std::span<const std::byte> bytes);
  awaitable<error_code> wait_for(tls::Next next);
  // Reads what has come into the inbox, and keeps its descriptors.
  std::pair<error_code, std::size_t> receive_message();
  // The same, waiting until something has come.
  awaitable<std::pair<error_code, std::size_t>> receive_with_descriptors();
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
  TimePoint read_end_ = TimePoint::max();   // moves on with every byte
  TimePoint limit_end_ = TimePoint::max();  // fixed by limit_reading()
  TimePoint write_end_ = TimePoint::max();
  bool read_late_ = false;
  bool reading_message_ = false;
  bool broken_ = false;
  bool writing_ = false;
  bool closes_when_sent_ = false;
  std::deque<Outgoing> queue_;
  Timer sent_;  // flush() waits here; cancelled when the queue is empty
  std::array<std::byte, 16384> inbox_;
  std::size_t inbox_begin_ = 0;
  std::size_t inbox_end_ = 0;
  std::uint64_t bytes_received_ = 0;
  std::unique_ptr<tls::Stream> tls_;  // none: not encrypted
  bool accepts_descriptors_ = false;
  struct Received {
    Descriptor descriptor;
    std::uint64_t end;  // bytes_received_ after the read that brought it
  };
  std::deque<Received> descriptors_;  // not taken yet
};

}  // namespace rcb::net
