#include "server/net/sockets/connection.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <tuple>
#include <utility>

#include <boost/asio/buffer.hpp>
#include <fmt/format.h>
#include <poll.h>
#include <spdlog/spdlog.h>
#include <sys/socket.h>
#include <sys/uio.h>

#include "common/tls/off_loopback.hpp"
#include "common/wire/limits.hpp"

namespace rcb::net {
namespace {

constexpr std::size_t kPieceBytes = std::size_t{4} << 20U;      // of one read or write call
constexpr std::size_t kDescriptorsMax = 4;                      // that wait to be taken
constexpr std::size_t kTextPieceBytes = std::size_t{1} << 20U;  // memory reserved for JSON before its bytes arrive

}  // namespace

Connection::Connection(Socket socket, double frame_seconds)
    : socket_(std::move(socket)),
      frame_time_(duration_of(frame_seconds)),
      watch_(socket_.get_executor()),
      sent_(socket_.get_executor(), TimePoint::max()) {
  error_code ignored;
  socket_.non_blocking(true, ignored);
}

bool Connection::off_loopback() const {
  error_code error;
  const auto own = socket_.local_endpoint(error);
  return error || tls::off_loopback(*own.data());
}

awaitable<error_code> Connection::wait_for(tls::Next next) {
  auto [error] =
      co_await socket_.async_wait(next == tls::Next::wait_writable ? Socket::wait_write : Socket::wait_read, kAwait);
  // A wait that ends by itself just before it would be cancelled doesn't say so.
  if (!error && read_late_ && next == tls::Next::wait_readable) error = asio::error::operation_aborted;
  co_return error;
}

awaitable<Status> Connection::encrypt(const tls::Identity& identity, TimePoint end) {
  auto stream = tls::Stream::accept(identity, socket_.native_handle());
  if (!stream.ok()) co_return stream.status();
  tls_ = std::move(*stream);
  limit_reading(now() + (end - now()) / 2);
  tls::Progress progress = tls_->handshake();
  error_code error;
  while (!broken_ && !error && progress.next != tls::Next::done && progress.next != tls::Next::failed) {
    error = co_await wait_for(progress.next);
    if (!broken_ && !error) progress = tls_->handshake();
    if (!broken_ && tls_->peer_has_begun()) limit_reading(end);
  }
  limit_reading(end);
  if (!broken_ && progress.next == tls::Next::done) co_return Status();
  const bool silent = read_late_ && !tls_->peer_has_begun();
  if (!broken_ && (silent || tls_->peer_is_plain())) {
    tls_.reset();
    co_return Status(Code::protocol_error,
                     silent ? "TLS 1.3 is spoken here, and the client hasn't begun in time"
                            : "TLS 1.3 is spoken here, and the client doesn't speak it",
                     "see PROTOCOL.md, 'Encryption'; a tunnel should end at a loopback address of the service");
  }
  const std::string why = tls_->why().empty() ? error.message() : tls_->why();
  close();
  co_return Status(Code::unavailable, "no TLS 1.3: " + why);
}

Descriptor Connection::take_descriptor() {
  if (descriptors_.empty()) return {};
  Descriptor descriptor = std::move(descriptors_.front().descriptor);
  descriptors_.pop_front();
  return descriptor;
}

void Connection::close_descriptors_read() {
  const std::uint64_t read = bytes_received_ - (inbox_end_ - inbox_begin_);
  while (!descriptors_.empty() && descriptors_.front().end <= read) descriptors_.pop_front();
}

// One timer serves all deadlines. It isn't moved when bytes arrive: if it fires too early it is armed again.
void Connection::arm() {
  const TimePoint end = std::min({read_end_, limit_end_, write_end_});
  if (broken_ || end >= watch_at_) return;
  watch_at_ = end;
  watch_.expires_at(end);
  watch_.async_wait([weak = weak_from_this()](error_code error) {
    const auto self = weak.lock();
    if (error || !self) return;
    self->watch_at_ = TimePoint::max();
    const TimePoint time = now();
    if (std::min(self->read_end_, self->limit_end_) <= time) {
      self->read_late_ = true;
      error_code ignored;
      self->socket_.cancel(ignored);  // the reader wakes with an error; the socket can still send why
      self->read_end_ = self->limit_end_ = TimePoint::max();
    }
    if (self->write_end_ <= time) {
      spdlog::info("a connection is closed: for {} s its other side has read nothing",
                   std::chrono::duration_cast<std::chrono::seconds>(self->frame_time_).count());
      self->close();
    }
    self->arm();
  });
}

void Connection::limit_reading(TimePoint end) {
  limit_end_ = end;
  arm();
}

Status Connection::read_failed(const error_code& error) const {
  if (read_late_) return {Code::deadline_exceeded, "the rest of a frame didn't come in time"};
  return {Code::unavailable, error ? error.message() : "the connection is closed"};
}

// Not a coroutine: GCC 12 doesn't align what lies in a coroutine's frame, and cmsghdr needs it.
std::pair<error_code, std::size_t> Connection::receive_message() {
  alignas(cmsghdr) std::array<char, CMSG_SPACE(kDescriptorsMax * sizeof(int))> control;
  iovec piece{inbox_.data(), inbox_.size()};
  msghdr message{};
  message.msg_iov = &piece;
  message.msg_iovlen = 1;
  message.msg_control = control.data();
  message.msg_controllen = control.size();
  const ssize_t bytes = ::recvmsg(socket_.native_handle(), &message, MSG_DONTWAIT | MSG_CMSG_CLOEXEC);
  if (bytes < 0) return {error_code(errno, boost::system::system_category()), 0};
  for (cmsghdr* part = CMSG_FIRSTHDR(&message); part != nullptr; part = CMSG_NXTHDR(&message, part)) {
    if (part->cmsg_level != SOL_SOCKET || part->cmsg_type != SCM_RIGHTS) continue;
    const std::size_t count = (part->cmsg_len - CMSG_LEN(0)) / sizeof(int);
    for (std::size_t k = 0; k < count; ++k) {
      int number = -1;
      std::memcpy(&number, CMSG_DATA(part) + k * sizeof(int), sizeof(int));
      Descriptor descriptor(number);  // closed if there are more than anybody has a use for
      if (descriptors_.size() < kDescriptorsMax)
        descriptors_.push_back({std::move(descriptor), bytes_received_ + static_cast<std::uint64_t>(bytes)});
    }
  }
  if (bytes == 0) return {asio::error::eof, 0};
  return {error_code(), static_cast<std::size_t>(bytes)};
}

awaitable<std::pair<error_code, std::size_t>> Connection::receive_with_descriptors() {
  while (true) {
    const auto received = receive_message();
    const error_code& error = received.first;
    if (error == asio::error::would_block || error == asio::error::try_again || error == asio::error::interrupted) {
      auto [waited] = co_await socket_.async_wait(Socket::wait_read, kAwait);
      if (waited) co_return std::pair(waited, std::size_t{0});
      continue;
    }
    if (!error) co_await asio::post(socket_.get_executor(), asio::use_awaitable);  // others have their turn
    co_return received;
  }
}

awaitable<std::pair<error_code, std::size_t>> Connection::read_encrypted(std::span<std::byte> into) {
  while (true) {
    const tls::Progress progress = tls_->read(into);
    error_code error;
    if (progress.next == tls::Next::done) {
      co_await asio::post(socket_.get_executor(), asio::use_awaitable);  // others have their turn
      co_return std::pair(error, progress.bytes);
    }
    if (progress.next == tls::Next::ended)
      error = asio::error::eof;
    else if (progress.next == tls::Next::failed)
      error = asio::error::connection_aborted;
    else
      error = co_await wait_for(progress.next);
    if (error) co_return std::pair(error, std::size_t{0});
  }
}

awaitable<std::pair<error_code, std::size_t>> Connection::write_encrypted(std::span<const std::byte> bytes) {
  while (true) {
    const tls::Progress progress = tls_->write(bytes);
    error_code error;
    if (progress.next == tls::Next::done) {
      co_await asio::post(socket_.get_executor(), asio::use_awaitable);
      co_return std::pair(error, progress.bytes);
    }
    if (progress.next == tls::Next::ended || progress.next == tls::Next::failed)
      error = asio::error::broken_pipe;
    else
      error = co_await wait_for(progress.next);
    if (error) co_return std::pair(error, std::size_t{0});
  }
}

awaitable<Status> Connection::refill() {
  inbox_begin_ = inbox_end_ = 0;
  if (broken_ || read_late_) co_return read_failed({});
  error_code error;
  std::size_t bytes = 0;
  if (accepts_descriptors_)
    std::tie(error, bytes) = co_await receive_with_descriptors();
  else if (tls_)
    std::tie(error, bytes) = co_await read_encrypted(inbox_);
  else
    std::tie(error, bytes) = co_await socket_.async_read_some(asio::buffer(inbox_.data(), inbox_.size()), kAwait);
  if (error) co_return read_failed(error);
  inbox_end_ = bytes;
  bytes_received_ += bytes;
  co_return Status();
}

awaitable<Status> Connection::read_exactly(std::span<std::byte> into) {
  while (!into.empty()) {
    if (inbox_begin_ < inbox_end_) {
      const std::size_t bytes = std::min(into.size(), inbox_end_ - inbox_begin_);
      std::memcpy(into.data(), inbox_.data() + inbox_begin_, bytes);
      inbox_begin_ += bytes;
      into = into.subspan(bytes);
    } else if (into.size() < inbox_.size()) {
      Status status = co_await refill();
      if (!status.ok()) co_return status;
    } else {
      if (broken_ || read_late_) co_return read_failed({});
      const std::size_t piece = std::min(into.size(), kPieceBytes);
      error_code error;
      std::size_t bytes = 0;
      if (tls_)
        std::tie(error, bytes) = co_await read_encrypted(into.first(piece));
      else
        std::tie(error, bytes) = co_await socket_.async_read_some(asio::buffer(into.data(), piece), kAwait);
      if (error) co_return read_failed(error);
      bytes_received_ += bytes;
      into = into.subspan(bytes);
    }
    touch_reading();
  }
  co_return Status();
}

awaitable<Result<Frame>> Connection::read_frame(std::uint64_t json_bytes_max, std::uint64_t bulk_bytes_max) {
  read_end_ = TimePoint::max();
  if (inbox_begin_ == inbox_end_) {
    const Status status = co_await refill();
    if (!status.ok() && status.code() == Code::unavailable) co_return Status(Code::unavailable, "");
    if (!status.ok()) co_return status;
  }
  reading_message_ = true;
  Result<Frame> frame = co_await read_message(json_bytes_max, bulk_bytes_max);
  reading_message_ = false;
  co_return frame;
}

awaitable<Result<Frame>> Connection::read_message(std::uint64_t json_bytes_max, std::uint64_t bulk_bytes_max) {
  touch_reading();
  arm();
  wire::HeaderBytes bytes;
  Status status = co_await read_exactly(bytes);
  if (!status.ok()) co_return status;
  Result<wire::FrameHeader> header = wire::decode_header(bytes);
  if (!header.ok()) co_return header.status();
  status = wire::check_lengths(*header, json_bytes_max, bulk_bytes_max);
  if (!status.ok()) co_return status;
  const bool large = header->json_bytes >= wire::kLargeRequest;
  auto& large_json = asio::use_service<LargeJson>(asio::query(socket_.get_executor(), asio::execution::context));
  LargeJson::Place place;
  if (header->json_bytes > LargeJson::kWithoutPlaceBytes) {
    read_end_ = TimePoint::max();  // waiting for a place isn't the peer's fault
    place = co_await large_json.take_place();
  }
  if (large) limit_reading(now() + frame_time_);  // for the whole text, since others may wait for the place
  std::string text;
  status = co_await read_text(text, header->json_bytes);
  if (large) limit_reading(TimePoint::max());
  if (!status.ok()) co_return status;
  status = wire::verify_checksum(bytes, text);
  if (!status.ok()) co_return status;
  read_end_ = TimePoint::max();
  Result<wire::Json> json = wire::Json();
  if (large)
    json = co_await large_json.parse(std::move(text));
  else
    json = wire::parse_json(text);
  if (!json.ok()) co_return json.status();
  // The time between two bytes of the bulk counts from when somebody reads it: who lets it wait (a slice whose push
  // isn't open yet) has a limit of his own.
  co_return Frame{*header, std::move(*json)};
}

// Memory grows with the bytes that arrive: an announcement alone costs nothing.
awaitable<Status> Connection::read_text(std::string& text, std::size_t bytes) {
  Status status;
  while (status.ok() && text.size() < bytes) {
    const std::size_t old = text.size();
    text.resize(std::min(bytes, old + kTextPieceBytes));
    status = co_await read_exactly(std::as_writable_bytes(std::span(text.data(), text.size()).subspan(old)));
  }
  co_return status;
}

awaitable<Status> Connection::read_bulk(std::span<std::byte> into) {
  touch_reading();
  arm();
  Status status = co_await read_exactly(into);
  read_end_ = TimePoint::max();
  co_return status;
}

awaitable<Status> Connection::skip_bulk(const Frame& frame, std::uint64_t bytes) {
  if ((frame.header.flags & wire::kFlagBulkChecksum) != 0) bytes += 8;
  Buffer<std::byte> waste(std::min<std::uint64_t>(bytes, std::uint64_t{256} << 10U));
  while (bytes > 0) {
    const std::size_t piece = std::min<std::uint64_t>(bytes, waste.size());
    const Status status = co_await read_bulk(waste.span().first(piece));
    if (!status.ok()) co_return status;
    bytes -= piece;
  }
  co_return Status();
}

Status Connection::send_message(wire::FrameType type, std::uint64_t request, wire::Json json,
                                std::vector<wire::Array> arrays, std::shared_ptr<void> held) {
  if (broken_) return {};
  if (!arrays.empty()) json["arrays"] = wire::describe(arrays);
  const std::string text = wire::dump_json(json);
  if (text.size() > wire::kReplyJsonBytesMax)
    return {Code::internal,
            fmt::format("the answer has {} bytes of JSON, a frame takes {}", text.size(), wire::kReplyJsonBytesMax),
            "ask for less of it"};  // our bug: every answer is made to fit
  send_text(type, request, text, std::make_shared<const std::vector<wire::Array>>(std::move(arrays)), std::move(held));
  return {};
}

void Connection::send(wire::FrameType type, std::uint64_t request, const wire::Json& json) {
  send_text(type, request, wire::dump_json(json));
}

void Connection::send_text(wire::FrameType type, std::uint64_t request, const std::string& json,
                           std::shared_ptr<const std::vector<wire::Array>> arrays, std::shared_ptr<void> held) {
  if (broken_) return;
  wire::FrameHeader header;
  header.type = type;
  header.request = request;
  if (arrays)
    for (const wire::Array& array : *arrays) header.bulk_bytes += array.bytes.size();
  enqueue({wire::encode_frame(header, json), std::move(arrays), std::move(held)});
}

void Connection::send_shared(std::shared_ptr<const std::string> frame) {
  if (!broken_) enqueue({{}, nullptr, nullptr, std::move(frame)});
}

void Connection::enqueue(Outgoing outgoing) {
  queue_.push_back(std::move(outgoing));
  if (writing_) return;
  writing_ = true;
  asio::co_spawn(
      socket_.get_executor(), [self = shared_from_this()]() -> awaitable<void> { co_await self->write_all(); },
      asio::detached);
}

awaitable<void> Connection::write_all() {
  while (!queue_.empty() && !broken_) {
    const Outgoing outgoing = std::move(queue_.front());
    queue_.pop_front();
    bool sent = co_await write_span(std::as_bytes(std::span(outgoing.frame ? *outgoing.frame : outgoing.head)));
    for (std::size_t i = 0; sent && outgoing.arrays && i < outgoing.arrays->size(); ++i)
      sent = co_await write_span((*outgoing.arrays)[i].bytes.span());
    if (!sent) close();
  }
  if (closes_when_sent_) close();
  write_end_ = TimePoint::max();
  writing_ = false;
  sent_.cancel();
}

awaitable<bool> Connection::write_span(std::span<const std::byte> bytes) {
  while (!bytes.empty()) {
    if (broken_) co_return false;
    write_end_ = now() + frame_time_;
    arm();
    const std::size_t piece = std::min(bytes.size(), kPieceBytes);
    error_code error;
    std::size_t count = 0;
    if (tls_)
      std::tie(error, count) = co_await write_encrypted(bytes.first(piece));
    else
      std::tie(error, count) = co_await socket_.async_write_some(asio::buffer(bytes.data(), piece), kAwait);
    if (error == asio::error::operation_aborted && !broken_) continue;  // a read timeout cancels both directions
    if (error) co_return false;
    bytes = bytes.subspan(count);
  }
  co_return true;
}

awaitable<void> Connection::flush() {
  if (writing_) co_await sent_.async_wait(kAwait);
}

awaitable<void> Connection::end_gently() {
  co_await flush();
  if (broken_) co_return;
  error_code ignored;
  if (tls_) tls_->end_sending();
  socket_.shutdown(Socket::shutdown_send, ignored);
  read_late_ = false;
  limit_reading(now() + std::chrono::seconds(1));
  while (true) {
    inbox_begin_ = inbox_end_ = 0;
    const Status status = co_await refill();
    if (!status.ok() || inbox_end_ == 0) break;
  }
  close();
}

bool Connection::peer_has_gone() { return broken_ || polled(POLLRDHUP | POLLHUP | POLLERR); }
bool Connection::peer_is_lost() { return broken_ || polled(POLLHUP | POLLERR); }

bool Connection::polled(short events) {
  pollfd watched{socket_.native_handle(), POLLRDHUP, 0};
  return ::poll(&watched, 1, 0) > 0 && (watched.revents & events) != 0;
}

void Connection::close_saying(const Status& why) {
  if (tls_ && !tls_->open()) return close();  // nothing can be said yet
  closes_when_sent_ = true;
  frame_time_ = std::chrono::seconds(1);
  write_end_ = now() + frame_time_;
  send(wire::FrameType::failure, 0, wire::failure_json(why));
  arm();
}

void Connection::close() {
  if (std::exchange(broken_, true)) return;
  error_code ignored;
  if (tls_) tls_->end();
  socket_.close(ignored);
  watch_.cancel();
}

}  // namespace rcb::net
