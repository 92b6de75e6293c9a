// What Identity and Stream share of OpenSSL: owners of its objects, the settings of both sides, its reasons in words.
#pragma once

#include <memory>
#include <string>

#include "common/openssl/openssl.hpp"

namespace rcb::tls {

template <auto& kFree>
struct Free {
  void operator()(auto* object) const { kFree(object); }
};
using ContextPointer = std::unique_ptr<SSL_CTX, Free<SSL_CTX_free>>;
using CertificatePointer = std::unique_ptr<X509, Free<X509_free>>;
using KeyPointer = std::unique_ptr<EVP_PKEY, Free<EVP_PKEY_free>>;

// The settings of both sides; null if this OpenSSL has no TLS 1.3.
ContextPointer make_context(const SSL_METHOD* method);
// SHA-256 of the certificate as hex digits; empty if it can't be computed.
std::string fingerprint_of(const X509* certificate);
// OpenSSL's last reason on this thread.
std::string last_reason();

}  // namespace rcb::tls
