#include "common/tls/stream.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <string_view>
#include <utility>

#include <sys/socket.h>

#include "common/tls/openssl.hpp"

namespace rcb::tls {
namespace {

// Bytes that are encrypted before they go to the socket in one call: a call for each record of 16 KiB takes longer.
constexpr std::size_t kBatchBytes = std::size_t{64} << 10U;

// Bytes that one call takes from the socket at most. OpenSSL goes on reading as long as records without data come, and
// nobody may keep the I/O thread of a service by sending such.
constexpr std::size_t kReadableBytes = std::size_t{1} << 20U;

// A peer may renew its keys so often, and once more for each so many bytes of data.
constexpr std::uint64_t kRenewalsMin = 16;
constexpr std::uint64_t kRenewalBytes = std::uint64_t{1} << 20U;

bool would_block() { return errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR; }

}  // namespace

// OpenSSL's own BIO for sockets would write each record by itself, and without MSG_NOSIGNAL, so that a peer that has
// gone would end a solver by SIGPIPE. This one puts records into outgoing_.
struct Stream::Bio {
  static Stream& stream(BIO* bio) { return *static_cast<Stream*>(BIO_get_data(bio)); }

  static int write(BIO* bio, const char* from, int bytes) {
    BIO_clear_retry_flags(bio);
    stream(bio).outgoing_.append(from, static_cast<std::size_t>(bytes));
    return bytes;
  }

  static int read(BIO* bio, char* to, int bytes) {
    BIO_clear_retry_flags(bio);
    Stream& self = stream(bio);
    const auto most = std::min(static_cast<std::size_t>(bytes), self.readable_);
    const ssize_t got = most > 0 ? ::recv(self.socket_, to, most, MSG_DONTWAIT) : -1;
    if (got < 0 && (most == 0 || would_block())) BIO_set_retry_read(bio);
    if (got > 0) self.readable_ -= static_cast<std::size_t>(got);
    if (got == 0) BIO_set_flags(bio, BIO_FLAGS_IN_EOF);
    return static_cast<int>(got);
  }

  static long control(BIO* bio, int command, long, void*) {
    if (command == BIO_CTRL_EOF) return BIO_test_flags(bio, BIO_FLAGS_IN_EOF) != 0 ? 1 : 0;
    return command == BIO_CTRL_FLUSH ? 1 : 0;
  }

  static const BIO_METHOD* method() {
    static const BIO_METHOD* const made = [] {
      BIO_METHOD* method = BIO_meth_new(BIO_get_new_index() | BIO_TYPE_SOURCE_SINK, "socket in batches");
      if (method == nullptr) return method;
      BIO_meth_set_write(method, write);
      BIO_meth_set_read(method, read);
      BIO_meth_set_ctrl(method, control);
      BIO_meth_set_create(method, [](BIO* bio) {
        BIO_set_init(bio, 1);
        return 1;
      });
      return method;
    }();
    return made;
  }
};

namespace {

// What SSL_get_error() judges by besides the call's own result.
void clear_errors() {
  ERR_clear_error();
  errno = 0;
}

// Shared by all connections of this process.
SSL_CTX* client_context() {
  static const ContextPointer context = make_context(TLS_client_method());
  return context.get();
}

}  // namespace

Stream::Stream(ssl_st* ssl, int socket) : ssl_(ssl), socket_(socket) {}

Stream::~Stream() { SSL_free(ssl_); }

Result<std::unique_ptr<Stream>> Stream::make(ssl_st* ssl, int socket) {
  BIO* bio = ssl != nullptr && Bio::method() != nullptr ? BIO_new(Bio::method()) : nullptr;
  if (bio == nullptr) {
    Status status(Code::unsupported, "this machine's OpenSSL has no TLS 1.3: " + last_reason());
    SSL_free(ssl);
    return status;
  }
  std::unique_ptr<Stream> stream(new Stream(ssl, socket));
  BIO_set_data(bio, stream.get());
  SSL_set_msg_callback(ssl, [](int sent, int, int type, const void* message, std::size_t bytes, SSL*, void* self) {
    static_cast<Stream*>(self)->count_message(sent != 0, type, message, bytes);
  });
  SSL_set_msg_callback_arg(ssl, stream.get());
  SSL_set_bio(ssl, bio, bio);
  return stream;
}

Result<std::unique_ptr<Stream>> Stream::accept(const Identity& identity, int socket) {
  ssl_st* ssl = SSL_new(identity.context_);
  if (ssl != nullptr) SSL_set_accept_state(ssl);
  auto stream = make(ssl, socket);
  if (stream.ok()) (*stream)->certificate_ = identity.fingerprint();
  return stream;
}

Result<std::unique_ptr<Stream>> Stream::connect(int socket) {
  if (Status opened = open_openssl(); !opened.ok()) return opened;
  ssl_st* ssl = client_context() != nullptr ? SSL_new(client_context()) : nullptr;
  if (ssl != nullptr) SSL_set_connect_state(ssl);
  return make(ssl, socket);
}

bool Stream::look_at_first_byte() {
  if (peer_has_begun_ || peer_is_plain_) return true;
  constexpr unsigned char kAlert = 21;  // types of TLS's records
  constexpr unsigned char kHandshake = 22;
  unsigned char first = 0;
  errno = 0;
  if (::recv(socket_, &first, 1, MSG_PEEK | MSG_DONTWAIT) != 1) return false;
  peer_has_begun_ = first == kAlert || first == kHandshake;
  peer_is_plain_ = !peer_has_begun_;
  return true;
}

Progress Stream::handshake() {
  if (open_) return {Next::done};
  // A service says nothing before its client has. OpenSSL finds the end of the stream, should that come instead.
  if (!look_at_first_byte() && SSL_is_server(ssl_) == 1 && would_block()) return {Next::wait_readable};
  if (peer_is_plain_) return fail("it doesn't speak TLS");
  readable_ = kReadableBytes;
  clear_errors();
  const int returned = SSL_do_handshake(ssl_);
  Progress progress = returned == 1 ? Progress{Next::done} : stopped(returned);
  const Next flushed = flush();  // the reason for a failure, too
  if (progress.next == Next::ended) return fail({});
  if (progress.next == Next::failed) return progress;
  if (flushed != Next::done) return {flushed};
  if (progress.next != Next::done) return progress;
  if (SSL_is_server(ssl_) != 1) {
    const CertificatePointer shown(SSL_get1_peer_certificate(ssl_));
    certificate_ = shown ? fingerprint_of(shown.get()) : "";
    if (certificate_.empty()) return fail("it shows no certificate");
  }
  open_ = true;
  return {Next::done};
}

void Stream::count_message(bool sent, int type, const void* message, std::size_t bytes) {
  if (sent || type != SSL3_RT_HANDSHAKE || bytes == 0) return;
  if (*static_cast<const unsigned char*>(message) != SSL3_MT_KEY_UPDATE) return;
  ++renewals_;
  if (renews_too_often()) readable_ = 0;  // OpenSSL would go on with the next one
}

bool Stream::renews_too_often() const { return renewals_ > kRenewalsMin + received_ / kRenewalBytes; }

Progress Stream::read(std::span<std::byte> bytes) {
  readable_ = kReadableBytes;
  std::size_t have = 0;
  while (have < bytes.size()) {
    std::size_t got = 0;
    clear_errors();
    const int returned = SSL_read_ex(ssl_, bytes.data() + have, bytes.size() - have, &got);
    received_ += got;
    if (renews_too_often()) return fail("it renews its keys without need");
    if (returned != 1 && have > 0) break;  // it will say so again
    if (returned != 1) {
      const Progress progress = stopped(returned);
      if (progress.next == Next::failed) flush();  // tells the peer why
      return progress;
    }
    have += got;
  }
  return {Next::done, have};
}

Progress Stream::write(std::span<const std::byte> bytes) {
  std::size_t have = 0;
  while (have < bytes.size()) {
    while (have + accepted_ < bytes.size() && outgoing_.size() < kBatchBytes) {
      std::size_t put = 0;
      clear_errors();
      const int returned = SSL_write_ex(ssl_, bytes.data() + have + accepted_, bytes.size() - have - accepted_, &put);
      if (returned != 1) return stopped(returned);
      accepted_ += put;
    }
    const Next flushed = flush();
    if (flushed == Next::done) have += std::exchange(accepted_, 0);
    if (flushed != Next::done && have > 0) break;  // it will say so again
    if (flushed != Next::done) return {flushed};
  }
  return {Next::done, have};
}

Next Stream::flush() {
  std::string_view left = std::string_view(outgoing_).substr(flushed_);
  while (!left.empty()) {
    const ssize_t sent = ::send(socket_, left.data(), left.size(), MSG_DONTWAIT | MSG_NOSIGNAL);
    if (sent < 0 && would_block()) return Next::wait_writable;
    if (sent < 0) return lose(errno).next;
    left.remove_prefix(static_cast<std::size_t>(sent));
    flushed_ += static_cast<std::size_t>(sent);
  }
  outgoing_.clear();
  flushed_ = 0;
  return Next::done;
}

Progress Stream::stopped(int returned) {
  const int system = errno;
  switch (SSL_get_error(ssl_, returned)) {
    case SSL_ERROR_WANT_READ:
      return {Next::wait_readable};
    case SSL_ERROR_WANT_WRITE:
      return {Next::wait_writable};
    case SSL_ERROR_ZERO_RETURN:
      lose(0);
      return {Next::ended};
    case SSL_ERROR_SYSCALL:
      return lose(system);
    default:
      return fail(last_reason());
  }
}

Progress Stream::lose(int error) {
  peer_has_gone_ = true;
  return fail(error != 0 ? std::strerror(error) : "it has ended the connection");
}

Progress Stream::fail(std::string why) {
  if (why_.empty()) why_ = std::move(why);
  return {Next::failed};
}

void Stream::end_sending() {
  if (!open_ || !why_.empty() || accepted_ > 0) return;  // the peer must not take a part for all
  clear_errors();
  SSL_shutdown(ssl_);
  flush();
}

void Stream::end() {
  if (socket_ < 0) return;
  end_sending();
  socket_ = -1;
}

}  // namespace rcb::tls
