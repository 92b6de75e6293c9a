// Stream: one side of a TLS 1.3 connection over a socket that doesn't block. It never waits: a call that can't go on
// says what its caller must wait for, and is then made again with the same bytes.
//
// Invariants
// 1. Nothing older than TLS 1.3 is spoken; no session is resumed, so that every connection shows a certificate.
// 2. A peer whose first byte isn't TLS's is sent nothing, so that its caller can still answer it without TLS.
// 3. A call takes a bounded number of bytes from the socket, whatever comes, and a peer may renew its keys 16 times
//    and then once per MiB of data, since a renewal takes as long as the decryption of many bytes.
// 4. Whose certificate it is isn't judged here: whoever uses certificate() must (common/auth).
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include "common/base/status.hpp"
#include "common/tls/identity.hpp"

struct ssl_st;  // OpenSSL's SSL

namespace rcb::tls {

enum class Next {
  done,
  wait_readable,  // until the socket can be read
  wait_writable,  // until the socket can be written
  ended,          // the peer has ended the connection
  failed,         // why() says why; no call can succeed any more
};

struct Progress {
  Next next = Next::failed;
  std::size_t bytes = 0;  // read or written, where done
};

class Stream {
 public:
  // The service's side and the client's. The socket stays the caller's, who calls end() before closing it. Errors:
  // unsupported.
  static Result<std::unique_ptr<Stream>> accept(const Identity& identity, int socket);
  static Result<std::unique_ptr<Stream>> connect(int socket);
  ~Stream();
  Stream(const Stream&) = delete;
  Stream& operator=(const Stream&) = delete;

  // Must be done before anything is read or written. Never `ended`: that is a failure here.
  Progress handshake();
  bool open() const { return open_; }  // the handshake is done
  // Whether the peer's first byte has come and isn't TLS's. Then nothing was taken from the socket.
  bool peer_is_plain() const { return peer_is_plain_; }
  // Whether TLS's first byte has come.
  bool peer_has_begun() const { return peer_has_begun_; }
  // Whether a call has failed or ended because the connection is lost.
  bool peer_has_gone() const { return peer_has_gone_; }
  // Of the service's certificate, once the handshake is done.
  const std::string& certificate() const { return certificate_; }

  // Both move as many bytes as there are or fit, and at least one if done. `bytes` must not be empty. After a write the
  // next one goes on with the first byte that it has not reported as written, and with no fewer than before.
  Progress read(std::span<std::byte> bytes);
  Progress write(std::span<const std::byte> bytes);
  // Tells the peer, if there is room, that nothing more comes.
  void end_sending();
  // The same, and leaves the socket alone from here on.
  void end();
  const std::string& why() const { return why_; }

 private:
  Stream(ssl_st* ssl, int socket);
  struct Bio;
  static Result<std::unique_ptr<Stream>> make(ssl_st* ssl, int socket);
  // Looks at the peer's first byte, unless that is known; false with errno if it hasn't come.
  bool look_at_first_byte();
  Next flush();
  // Called for each message of TLS itself.
  void count_message(bool sent, int type, const void* message, std::size_t bytes);
  bool renews_too_often() const;
  Progress stopped(int returned);
  Progress fail(std::string why);
  Progress lose(int error);

  ssl_st* ssl_;
  int socket_;
  bool open_ = false;
  bool peer_is_plain_ = false;
  bool peer_has_begun_ = false;
  bool peer_has_gone_ = false;
  std::string certificate_;
  std::size_t readable_ = 0;    // bytes that this call may still take from the socket
  std::uint64_t received_ = 0;  // bytes of data
  std::uint64_t renewals_ = 0;  // of the peer's keys
  std::string outgoing_;        // encrypted, to be sent
  std::size_t flushed_ = 0;     // of outgoing_
  std::size_t accepted_ = 0;    // bytes of the caller's that are in outgoing_, and not yet reported as written
  std::string why_;
};

}  // namespace rcb::tls
