#include "client/lib/connect/connection.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstring>
#include <deque>
#include <exception>
#include <optional>
#include <thread>
#include <tuple>
#include <utility>

#include <boost/asio/as_tuple.hpp>
#include <boost/asio/awaitable.hpp>
#include <boost/asio/co_spawn.hpp>
#include <boost/asio/generic/stream_protocol.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/local/stream_protocol.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <boost/asio/write.hpp>
#include <boost/system/system_error.hpp>
#include <fcntl.h>
#include <fmt/format.h>
#include <sys/socket.h>
#include <unistd.h>

#include "client/lib/connect/addresses.hpp"
#include "common/base/tcp_peer.hpp"
#include "common/tls/off_loopback.hpp"
#include "common/tls/stream.hpp"
#include "common/wire/limits.hpp"

namespace rcb::client {
namespace {

namespace asio = boost::asio;
using boost::system::error_code;
using Socket = asio::generic::stream_protocol::socket;

constexpr auto kAwait = asio::as_tuple(asio::use_awaitable);
constexpr std::size_t kTransferMax = 4U << 20U;        // bytes asked of the kernel in one call (Asio's default: 64 KiB)
constexpr std::uint64_t kGrowthBytesMax = 64U << 20U;  // memory reserved before its bytes have come
constexpr std::size_t kInboxMax = 64;                  // frames received that nobody has read yet
constexpr int kPollRoundsMax = 64;
constexpr double kAskSeconds = 0.1;  // between questions whether to go on waiting

bool no_descriptors(const error_code& error) {
  return error == asio::error::no_descriptors || error == boost::system::errc::too_many_files_open_in_system;
}

Status no_descriptors_left(const Endpoint& endpoint) {
  return {Code::unavailable,
          fmt::format("no connection to {}: this process has no file descriptors left", endpoint.text()),
          kDescriptorsHint};
}

// Like asio::transfer_all, in larger pieces.
struct TransferLarge {
  std::size_t operator()(const error_code& error, std::size_t) const { return error ? 0 : kTransferMax; }
};

std::optional<asio::ip::tcp::endpoint> as_tcp(const Address& address) {
  asio::ip::tcp::endpoint tcp;
  if (address.size() > tcp.capacity()) return std::nullopt;
  std::memcpy(static_cast<void*>(tcp.data()), address.data(), address.size());
  return tcp;
}

}  // namespace

Deadline::Deadline(double seconds) {
  constexpr double kDay = 86400;
  const double bounded = std::isnan(seconds) ? 0 : std::clamp(seconds, 0.0, kDay);
  at_ = Clock::now() + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(bounded));
}

Deadline Deadline::within(double seconds) const { return Deadline(std::min(seconds, left_seconds())); }

struct Connection::State {
  asio::io_context io{1};
  Socket socket{io};
  Endpoint endpoint;
  NoticeHandler on_notice;
  WaitHandler on_wait;
  std::deque<Frame> inbox;
  Status standing;                   // why no more frames can come; ok while the connection stands
  std::unique_ptr<tls::Stream> tls;  // none: not encrypted
  bool this_machine = false;
  bool off_loopback = false;
  bool reads = false;  // read_frames() has been started
  bool said_goodbye = false;

  // Returns false.
  bool lose(Code code, const std::string& why) {
    if (standing.ok()) standing = Status(code, fmt::format("the connection to {} was lost: {}", endpoint.text(), why));
    error_code ignored;
    if (tls) tls->end();
    socket.close(ignored);
    return false;
  }
  bool lose(const Status& why) { return lose(why.code(), why.message()); }

  // Runs handlers until `done`, the deadline, or until no handler is left. False: not done.
  template <typename Done>
  bool run(const Done& done, const Deadline& deadline) {
    while (!done()) {
      if (io.stopped()) io.restart();
      const bool late = deadline.left_seconds() <= 0;
      const std::size_t handlers = late ? io.poll_one() : io.run_one_until(deadline.at());
      if (handlers == 0 && (late || io.stopped())) return done();
      if (late) return done();
    }
    return true;
  }

  // The same, but asks the caller from time to time whether to go on. If not, the connection is lost.
  template <typename Done>
  bool run_and_ask(const Done& done, const Deadline& deadline) {
    while (on_wait && standing.ok() && deadline.left_seconds() > kAskSeconds) {
      if (run(done, deadline.within(kAskSeconds))) return true;
      if (!on_wait()) return interrupt();
    }
    return run(done, deadline);
  }
  bool interrupt() {
    if (standing.ok())
      standing = Status(Code::interrupted,
                        fmt::format("interrupted; what {} was asked for may still be done", endpoint.text()));
    return lose(standing);
  }

  // Runs handlers until one of them has set the outcome. False: it hasn't in time, and the socket is closed.
  bool await(const std::optional<error_code>& outcome, const Deadline& deadline) {
    const auto ended = [&] { return outcome.has_value(); };
    if (run_and_ask(ended, deadline)) return true;
    error_code ignored;
    socket.close(ignored);
    run(ended, Deadline(1));  // the cancelled handler refers to `outcome`
    RCB_CHECK(outcome.has_value(), "a closed socket still waits");
    return false;
  }

  Result<bool> connect(const Address& address, const Deadline& deadline);
  Status open(const Deadline& deadline);
  // Waits for what TLS waits for. False: the deadline has passed, or the socket is lost.
  bool wait_for(tls::Next next, const Deadline& deadline);
  Status encrypt(const Deadline& deadline);
  asio::awaitable<std::pair<error_code, std::size_t>> read_encrypted(std::span<std::byte> into);
  asio::awaitable<error_code> write_encrypted(std::span<const Bytes> pieces);
  void start_reading();
  asio::awaitable<bool> fill(void* data, std::size_t size);
  asio::awaitable<bool> read_arrays(Frame& frame, const wire::FrameHeader& header);
  asio::awaitable<bool> read_frame();
  asio::awaitable<void> read_frames();
};

// True if connected, false if nobody listens there. Errors: deadline_exceeded, unavailable (no descriptor is left).
Result<bool> Connection::State::connect(const Address& address, const Deadline& deadline) {
  constexpr std::chrono::milliseconds kPause(10);
  error_code error;
  for (;; std::this_thread::sleep_for(kPause)) {
    socket.close(error);
    socket.open(address.protocol(), error);
    if (no_descriptors(error)) return no_descriptors_left(endpoint);
    if (error) return false;
    // Programs that the solver starts would inherit it, and keep it connected when the solver has gone.
    ::fcntl(socket.native_handle(), F_SETFD, FD_CLOEXEC);
    std::optional<error_code> outcome;
    socket.async_connect(address, [&outcome](const error_code& ended) { outcome = ended; });
    if (!await(outcome, deadline)) break;
    if (*outcome) return false;
    // Where too many others wait at a Unix socket Linux says "try again", which Asio takes for success.
    socket.remote_endpoint(error);
    if (error != asio::error::not_connected) return true;
    if (deadline.left_seconds() <= 0) break;
  }
  if (!standing) return standing;
  return Status(Code::deadline_exceeded, fmt::format("{} did not take the connection in time", endpoint.text()));
}

Status Connection::State::open(const Deadline& deadline) {
  const auto addresses = addresses_of(endpoint, deadline);
  if (!addresses) return addresses.status();
  for (const Address& address : *addresses) {
    const auto connected = connect(address, deadline);
    if (!connected) return connected.status();
    if (!connected.value()) continue;
    error_code ignored;
    if (endpoint.is_unix) {
      this_machine = true;
      if (Status status = check_server(socket.native_handle(), endpoint); !status) return status;
    } else {
      socket.set_option(asio::ip::tcp::no_delay(true), ignored);
      // A service may leave a slice unread until its push is opened.
      set_keep_alive(socket.native_handle(), kPeerGoneSeconds, 2 * kPeerGoneSeconds);
      const Address remote = socket.remote_endpoint(ignored);
      const auto peer = as_tcp(remote);
      const auto own = as_tcp(socket.local_endpoint(ignored));
      off_loopback = !peer || tls::off_loopback(*remote.data());
      this_machine = peer && own && (peer->address() == own->address() || !off_loopback);
    }
    return {};
  }
  if (endpoint.is_unix && ::access(endpoint.path.c_str(), W_OK) != 0 && errno == EACCES)
    return {Code::not_authorised, fmt::format("{} is out of reach of this user", endpoint.text()),
            "a service is for the user who has started it"};
  return {Code::unavailable, fmt::format("no service answers at {}", endpoint.text()), "start one: rcbctl up"};
}

bool Connection::State::wait_for(tls::Next next, const Deadline& deadline) {
  std::optional<error_code> outcome;
  socket.async_wait(next == tls::Next::wait_writable ? Socket::wait_write : Socket::wait_read,
                    [&outcome](const error_code& error) { outcome = error; });
  return await(outcome, deadline) && !*outcome;
}

Status Connection::State::encrypt(const Deadline& deadline) {
  auto stream = tls::Stream::connect(socket.native_handle());
  if (!stream) return stream.status();
  tls = std::move(*stream);
  tls::Progress progress = tls->handshake();
  while (progress.next == tls::Next::wait_readable || progress.next == tls::Next::wait_writable) {
    if (!wait_for(progress.next, deadline)) {
      tls->end();
      if (!standing) return standing;
      return {deadline.left_seconds() <= 0 ? Code::deadline_exceeded : Code::unavailable,
              fmt::format("{} takes connections but doesn't begin TLS", endpoint.text()),
              "the service may be stopped or busy; see its log"};
    }
    progress = tls->handshake();
  }
  if (progress.next == tls::Next::done) return {};
  if (tls->peer_has_gone())
    return {Code::unavailable, fmt::format("{} has ended the connection: {}", endpoint.text(), tls->why())};
  return {Code::protocol_error, fmt::format("no TLS 1.3 with {}: {}", endpoint.text(), tls->why()),
          tls->peer_is_plain() ? "nothing was told to it. The token is of a service that encrypts; one that is started "
                                 "with --trusted-network has another token"
                               : ""};
}

asio::awaitable<std::pair<error_code, std::size_t>> Connection::State::read_encrypted(std::span<std::byte> into) {
  while (true) {
    const tls::Progress progress = tls->read(into);
    if (progress.next == tls::Next::done) co_return std::pair(error_code(), progress.bytes);
    error_code error =
        progress.next == tls::Next::ended ? error_code(asio::error::eof) : error_code(asio::error::connection_aborted);
    if (progress.next == tls::Next::wait_readable || progress.next == tls::Next::wait_writable)
      std::tie(error) = co_await socket.async_wait(
          progress.next == tls::Next::wait_writable ? Socket::wait_write : Socket::wait_read, kAwait);
    if (error) co_return std::pair(error, std::size_t{0});
  }
}

asio::awaitable<error_code> Connection::State::write_encrypted(std::span<const Bytes> pieces) {
  for (Bytes piece : pieces)
    while (!piece.empty()) {
      const tls::Progress progress = tls->write(piece);
      error_code error = progress.next == tls::Next::done ? error_code() : error_code(asio::error::broken_pipe);
      if (progress.next == tls::Next::wait_readable || progress.next == tls::Next::wait_writable)
        std::tie(error) = co_await socket.async_wait(
            progress.next == tls::Next::wait_writable ? Socket::wait_write : Socket::wait_read, kAwait);
      if (error) co_return error;
      piece = piece.subspan(progress.bytes);
    }
  co_return error_code();
}

// Reads as much as the kernel has; Asio's composed read would ask for 64 KiB at a time.
asio::awaitable<bool> Connection::State::fill(void* data, std::size_t size) {
  auto* to = static_cast<char*>(data);
  while (size > 0) {
    error_code error;
    std::size_t got = 0;
    if (tls)
      std::tie(error, got) = co_await read_encrypted(std::as_writable_bytes(std::span(to, size)));
    else
      std::tie(error, got) = co_await socket.async_read_some(asio::buffer(to, size), kAwait);
    if (error)
      co_return lose(Code::unavailable,
                     error == asio::error::eof ? std::string("the service closed it") : error.message());
    to += got;
    size -= got;
  }
  co_return true;
}

asio::awaitable<bool> Connection::State::read_arrays(Frame& frame, const wire::FrameHeader& header) {
  const auto json = frame.json();
  if (!json) co_return lose(json.status());
  const auto specs = wire::array_specs(*json, header.bulk_bytes);
  if (!specs) co_return lose(specs.status());
  wire::BulkChecksum sum;
  const bool summed = (header.flags & wire::kFlagBulkChecksum) != 0;
  for (const wire::ArraySpec& spec : *specs) {
    wire::Array array{spec.name, spec.dtype, spec.shape, {}};
    while (array.bytes.size() < spec.bytes) {
      const std::size_t at = array.bytes.size();
      const std::size_t size = std::min(spec.bytes - at, kGrowthBytesMax);
      if (!array.bytes.try_reserve(at + size))
        co_return lose(Code::too_large, fmt::format("no memory for an array of {} bytes", spec.bytes));
      array.bytes.resize(at + size);
      if (!co_await fill(array.bytes.data() + at, size)) co_return false;
    }
    if (summed) sum.add(array.bytes.span());
    frame.arrays.push_back(std::move(array));
  }
  if (!summed) co_return true;
  std::array<std::byte, 8> tail{};
  if (!co_await fill(tail.data(), tail.size())) co_return false;
  if (wire::BulkChecksum::decode(tail) == sum.value()) co_return true;
  co_return lose(Code::protocol_error, "the checksum of an answer's arrays is wrong");
}

asio::awaitable<bool> Connection::State::read_frame() {
  wire::HeaderBytes bytes{};
  if (!co_await fill(bytes.data(), bytes.size())) co_return false;
  const auto header = wire::decode_header(bytes);
  Status status = header.status();
  if (status) status = wire::check_lengths(*header, wire::kReplyJsonBytesMax, ~std::uint64_t{0});
  if (!status) co_return lose(status);
  Frame frame;
  frame.type = header->type;
  frame.request = header->request;
  while (frame.text.size() < header->json_bytes) {
    const std::size_t at = frame.text.size();
    frame.text.resize(at + std::min<std::size_t>(header->json_bytes - at, 1U << 20U));
    if (!co_await fill(frame.text.data() + at, frame.text.size() - at)) co_return false;
  }
  status = wire::verify_checksum(bytes, frame.text);
  if (!status) co_return lose(status);
  // Arrays without elements are described in the JSON too, but have no bulk.
  if (header->bulk_bytes > 0 || (header->flags & wire::kFlagBulkChecksum) != 0 ||
      frame.text.find("\"arrays\"") != std::string::npos)
    if (!co_await read_arrays(frame, *header)) co_return false;
  if (frame.type == wire::FrameType::goodbye) {
    said_goodbye = standing.ok();
    co_return lose(Code::unavailable, "the service said goodbye");
  }
  if (frame.type == wire::FrameType::notice) {
    const auto json = frame.json();
    const auto text = json ? wire::string_field(*json, "notice") : Result<std::string>(json.status());
    if (text && on_notice) on_notice(*text);
    co_return true;
  }
  if (inbox.size() >= kInboxMax) co_return lose(Code::protocol_error, "answers to requests that were not made");
  inbox.push_back(std::move(frame));
  co_return true;
}

asio::awaitable<void> Connection::State::read_frames() {
  // Not `while (co_await ...) {}`: GCC 12 miscompiles the empty body to a trap.
  for (bool more = true; more;) more = co_await read_frame();
}

void Connection::State::start_reading() {
  if (std::exchange(reads, true)) return;
  asio::co_spawn(io, read_frames(), [this](const std::exception_ptr& thrown) {
    if (thrown) lose(Code::internal, "reading failed, perhaps for lack of memory");
  });
}

Connection::Connection(std::unique_ptr<State> state) : state_(std::move(state)) {}
Connection::~Connection() = default;

Result<std::unique_ptr<Connection>> Connection::open(const Endpoint& endpoint, const Deadline& deadline,
                                                     NoticeHandler on_notice, WaitHandler on_wait) {
  std::unique_ptr<State> state;
  try {
    state = std::make_unique<State>();
  } catch (const boost::system::system_error& fault) {
    if (no_descriptors(fault.code())) return no_descriptors_left(endpoint);
    return Status(Code::unavailable, fmt::format("no connection to {}: {}", endpoint.text(), fault.what()));
  }
  state->endpoint = endpoint;
  state->on_notice = std::move(on_notice);
  state->on_wait = std::move(on_wait);
  if (Status status = state->open(deadline); !status) return status;
  return std::unique_ptr<Connection>(new Connection(std::move(state)));
}

Status Connection::write(std::span<const Bytes> pieces, const Deadline& deadline) {
  State& s = *state_;
  s.start_reading();
  if (!s.standing) return s.standing;
  std::vector<asio::const_buffer> buffers;
  buffers.reserve(pieces.size());
  for (const Bytes& piece : pieces) buffers.emplace_back(piece.data(), piece.size());
  std::optional<error_code> outcome;
  if (s.tls)
    asio::co_spawn(s.io, s.write_encrypted(pieces), [&outcome](const std::exception_ptr& thrown, error_code error) {
      outcome = thrown ? error_code(asio::error::no_memory) : error;
    });
  else
    asio::async_write(s.socket, buffers, TransferLarge{},
                      [&outcome](const error_code& error, std::size_t) { outcome = error; });
  const auto written = [&] { return outcome.has_value(); };
  if (!s.run_and_ask(written, deadline)) {
    s.lose(Code::deadline_exceeded, "it did not take what was sent in time");
    s.run(written, Deadline(1));
    RCB_CHECK(outcome.has_value(), "a closed socket still writes");
  } else if (*outcome) {
    // The service's last message may still be in the socket, so the reader decides when the connection is lost.
    if (!s.run([&] { return !s.standing || !s.inbox.empty(); }, deadline.within(1)))
      s.lose(Code::unavailable, outcome->message());
    return s.standing ? Status(Code::unavailable, outcome->message()) : s.standing;
  }
  return s.standing;
}

Status Connection::write(const std::string& frames, const Deadline& deadline) {
  const Bytes piece = std::as_bytes(std::span(frames));
  return write(std::span(&piece, 1), deadline);
}

Result<Frame> Connection::read(const Deadline& deadline) {
  State& s = *state_;
  s.start_reading();
  if (!s.run_and_ask([&] { return !s.inbox.empty() || !s.standing; }, deadline))
    s.lose(Code::deadline_exceeded, "no answer in time");
  if (s.inbox.empty()) return s.standing;
  Frame frame = std::move(s.inbox.front());
  s.inbox.pop_front();
  return frame;
}

bool Connection::await_frame(const Deadline& deadline) {
  State& s = *state_;
  s.start_reading();
  return s.run_and_ask([&] { return !s.inbox.empty() || !s.standing; }, deadline);
}

bool Connection::has_frame() {
  State& s = *state_;
  s.start_reading();
  if (s.io.stopped()) s.io.restart();
  for (int round = 0; round < kPollRoundsMax && s.inbox.empty() && s.standing; ++round)
    if (s.io.poll_one() == 0) break;
  return !s.inbox.empty() || !s.standing;
}

Result<std::size_t> Connection::send_some(std::span<const iovec> pieces) {
  State& s = *state_;
  const auto lost = [&s](const std::string& why) {
    return Status(Code::unavailable, fmt::format("the connection to {} was lost: {}", s.endpoint.text(), why));
  };
  if (!s.tls) {
    msghdr message{};
    message.msg_iov = const_cast<iovec*>(pieces.data());  // sendmsg only reads
    message.msg_iovlen = pieces.size();
    const ssize_t count = ::sendmsg(handle(), &message, MSG_DONTWAIT | MSG_NOSIGNAL);
    if (count >= 0) return static_cast<std::size_t>(count);
    if (errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR) return std::size_t{0};
    return lost(std::strerror(errno));
  }
  std::size_t sent = 0;
  for (const iovec& piece : pieces) {
    const tls::Progress progress = s.tls->write({static_cast<const std::byte*>(piece.iov_base), piece.iov_len});
    if (progress.next == tls::Next::ended || progress.next == tls::Next::failed) return lost(s.tls->why());
    sent += progress.bytes;
    if (progress.bytes < piece.iov_len) break;
  }
  return sent;
}

Status Connection::send_at_once(Bytes frame, int descriptor) {
  RCB_CHECK(!state_->tls, "descriptors go over Unix sockets");
  iovec piece{const_cast<std::byte*>(frame.data()), frame.size()};  // sendmsg only reads
  alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int))> control{};
  msghdr message{};
  message.msg_iov = &piece;
  message.msg_iovlen = 1;
  if (descriptor >= 0) {
    message.msg_control = control.data();
    message.msg_controllen = control.size();
    cmsghdr* const part = CMSG_FIRSTHDR(&message);
    part->cmsg_level = SOL_SOCKET;
    part->cmsg_type = SCM_RIGHTS;
    part->cmsg_len = CMSG_LEN(sizeof(int));
    std::memcpy(CMSG_DATA(part), &descriptor, sizeof(int));
  }
  const ssize_t sent = ::sendmsg(handle(), &message, MSG_DONTWAIT | MSG_NOSIGNAL);
  if (sent == static_cast<ssize_t>(frame.size())) return {};
  return {Code::unavailable, fmt::format("{} can't be sent a request: {}", state_->endpoint.text(),
                                         sent < 0 ? std::strerror(errno) : "its socket is full")};
}

Status Connection::lost() const { return state_->standing; }
bool Connection::said_goodbye() const { return state_->said_goodbye; }
int Connection::handle() { return state_->socket.native_handle(); }
bool Connection::this_machine() const { return state_->this_machine; }
bool Connection::off_loopback() const { return state_->off_loopback; }
Status Connection::encrypt(const Deadline& deadline) { return state_->encrypt(deadline); }
std::string Connection::certificate() const { return state_->tls ? state_->tls->certificate() : ""; }

}  // namespace rcb::client
