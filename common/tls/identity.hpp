// TLS 1.3 over sockets that don't block (OpenSSL). Used by the service and by the client library.
//
// Identity: the key and the self-signed certificate that a process shows to its clients. Both are made anew by each
// process, and the key never leaves its memory. Nobody needs to be given the certificate: client and service put its
// fingerprint into the proofs of the token (common/auth), as RFC 5929 (tls-server-end-point) has it, and whoever sits
// between the two with another certificate can't make these proofs.
#pragma once

#include <memory>
#include <string>

#include "common/base/status.hpp"

struct ssl_ctx_st;  // OpenSSL's SSL_CTX

namespace rcb::tls {

class Identity {
 public:
  // Errors: unsupported, if this machine's OpenSSL has no TLS 1.3 or makes no certificates.
  static Result<std::shared_ptr<const Identity>> make();
  ~Identity();
  Identity(const Identity&) = delete;
  Identity& operator=(const Identity&) = delete;

  // SHA-256 of the certificate: 64 hex digits.
  const std::string& fingerprint() const { return fingerprint_; }

 private:
  friend class Stream;
  Identity(ssl_ctx_st* context, std::string fingerprint) : context_(context), fingerprint_(std::move(fingerprint)) {}
  ssl_ctx_st* context_;
  std::string fingerprint_;
};

}  // namespace rcb::tls
