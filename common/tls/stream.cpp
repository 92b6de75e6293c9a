#include "common/tls/stream.hpp"

#include <cerrno>
#include <cstring>
#include <limits>
#include <utility>

#include <openssl/bio.h>
#include <openssl/err.h>
#include <sys/socket.h>

#include "common/tls/openssl.hpp"

namespace rcb::tls {
namespace {

// OpenSSL's own BIO for sockets writes without MSG_NOSIGNAL: a peer that has gone would end a solver by SIGPIPE.
int socket_of(BIO* bio) { return static_cast<int>(reinterpret_cast<std::intptr_t>(BIO_get_data(bio))); }

bool would_block() { return errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR; }

int write_socket(BIO* bio, const char* from, int bytes) {
  BIO_clear_retry_flags(bio);
  const ssize_t sent = ::send(socket_of(bio), from, static_cast<std::size_t>(bytes), MSG_DONTWAIT | MSG_NOSIGNAL);
  if (sent < 0 && would_block()) BIO_set_retry_write(bio);
  return static_cast<int>(sent);
}

int read_socket(BIO* bio, char* to, int bytes) {
  BIO_clear_retry_flags(bio);
  const ssize_t got = ::recv(socket_of(bio), to, static_cast<std::size_t>(bytes), MSG_DONTWAIT);
  if (got < 0 && would_block()) BIO_set_retry_read(bio);
  if (got == 0) BIO_set_flags(bio, BIO_FLAGS_IN_EOF);
  return static_cast<int>(got);
}

long control_socket(BIO* bio, int command, long, void*) {
  if (command == BIO_CTRL_EOF) return BIO_test_flags(bio, BIO_FLAGS_IN_EOF) != 0 ? 1 : 0;
  return command == BIO_CTRL_FLUSH ? 1 : 0;
}

const BIO_METHOD* socket_method() {
  static const BIO_METHOD* const method = [] {
    BIO_METHOD* made = BIO_meth_new(BIO_get_new_index() | BIO_TYPE_SOURCE_SINK, "socket without signals");
    if (made == nullptr) return made;
    BIO_meth_set_write(made, write_socket);
    BIO_meth_set_read(made, read_socket);
    BIO_meth_set_ctrl(made, control_socket);
    BIO_meth_set_create(made, [](BIO* bio) {
      BIO_set_init(bio, 1);
      return 1;
    });
    return made;
  }();
  return method;
}

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
  BIO* bio = ssl != nullptr && socket_method() != nullptr ? BIO_new(socket_method()) : nullptr;
  if (bio == nullptr) {
    Status status(Code::unsupported, "this machine's OpenSSL has no TLS 1.3: " + last_reason());
    SSL_free(ssl);
    return status;
  }
  BIO_set_data(bio, reinterpret_cast<void*>(static_cast<std::intptr_t>(socket)));
  SSL_set_bio(ssl, bio, bio);
  return std::unique_ptr<Stream>(new Stream(ssl, socket));
}

Result<std::unique_ptr<Stream>> Stream::accept(const Identity& identity, int socket) {
  ssl_st* ssl = SSL_new(identity.context_);
  if (ssl != nullptr) SSL_set_accept_state(ssl);
  auto stream = make(ssl, socket);
  if (stream.ok()) (*stream)->certificate_ = identity.fingerprint();
  return stream;
}

Result<std::unique_ptr<Stream>> Stream::connect(int socket) {
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
  if (open_) return {Next::done, 0};
  // A service says nothing before its client has. OpenSSL finds the end of the stream, should that come instead.
  if (!look_at_first_byte() && SSL_is_server(ssl_) == 1 && would_block()) return {Next::wait_readable, 0};
  if (peer_is_plain_) return fail("it doesn't speak TLS");
  clear_errors();
  if (const int returned = SSL_do_handshake(ssl_); returned != 1) {
    const Progress progress = stopped(returned);
    return progress.next == Next::ended ? fail({}) : progress;
  }
  if (SSL_is_server(ssl_) != 1) {
    const CertificatePointer shown(SSL_get1_peer_certificate(ssl_));
    certificate_ = shown ? fingerprint_of(shown.get()) : "";
    if (certificate_.empty()) return fail("it shows no certificate");
  }
  open_ = true;
  return {Next::done, 0};
}

Progress Stream::read(std::span<std::byte> bytes) {
  std::size_t have = 0;
  while (have < bytes.size()) {
    std::size_t got = 0;
    clear_errors();
    const int returned = SSL_read_ex(ssl_, bytes.data() + have, bytes.size() - have, &got);
    if (returned != 1 && have > 0) break;  // it will say so again
    if (returned != 1) return stopped(returned);
    have += got;
  }
  return {Next::done, have};
}

Progress Stream::write(std::span<const std::byte> bytes) {
  std::size_t have = 0;
  while (have < bytes.size()) {
    std::size_t put = 0;
    clear_errors();
    const int returned = SSL_write_ex(ssl_, bytes.data() + have, bytes.size() - have, &put);
    if (returned != 1 && have > 0) break;
    if (returned != 1) return stopped(returned);
    have += put;
  }
  return {Next::done, have};
}

Progress Stream::stopped(int returned) {
  const int system = errno;
  switch (SSL_get_error(ssl_, returned)) {
    case SSL_ERROR_WANT_READ:
      return {Next::wait_readable, 0};
    case SSL_ERROR_WANT_WRITE:
      return {Next::wait_writable, 0};
    case SSL_ERROR_ZERO_RETURN:
      why_ = "it has ended the connection";
      return {Next::ended, 0};
    case SSL_ERROR_SYSCALL:
      return fail(system != 0 ? std::strerror(system) : "it has ended the connection");
    default:
      return fail(last_reason());
  }
}

Progress Stream::fail(std::string why) {
  if (why_.empty()) why_ = std::move(why);
  return {Next::failed, 0};
}

void Stream::end_sending() {
  clear_errors();
  if (open_ && why_.empty()) SSL_shutdown(ssl_);
}

void Stream::end() {
  if (socket_ < 0) return;
  end_sending();
  BIO_set_data(SSL_get_wbio(ssl_), reinterpret_cast<void*>(std::intptr_t{-1}));  // the number may soon be another's
  socket_ = -1;
}

}  // namespace rcb::tls
