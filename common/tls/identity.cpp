#include "common/tls/identity.hpp"

#include <fmt/format.h>

#include "common/tls/openssl.hpp"

namespace rcb::tls {
namespace {

constexpr const char* kCurve = "P-256";
// RFC 5280's word for no date of expiry: a service may run for long, and its key ends with it.
constexpr const char* kNoEnd = "99991231235959Z";

CertificatePointer self_signed(EVP_PKEY* key) {
  CertificatePointer certificate(X509_new());
  if (!certificate) return nullptr;
  X509* x509 = certificate.get();
  X509_NAME* name = X509_get_subject_name(x509);
  const auto* common_name = reinterpret_cast<const unsigned char*>("rcbd");
  const bool made = X509_set_version(x509, X509_VERSION_3) == 1 &&
                    ASN1_INTEGER_set(X509_get_serialNumber(x509), 1) == 1 &&
                    X509_gmtime_adj(X509_getm_notBefore(x509), -24L * 3600) != nullptr &&
                    ASN1_TIME_set_string(X509_getm_notAfter(x509), kNoEnd) == 1 &&
                    X509_NAME_add_entry_by_txt(name, "CN", MBSTRING_ASC, common_name, -1, -1, 0) == 1 &&
                    X509_set_issuer_name(x509, name) == 1 && X509_set_pubkey(x509, key) == 1 &&
                    X509_sign(x509, key, EVP_sha256()) > 0;
  return made ? std::move(certificate) : nullptr;
}

}  // namespace

Result<std::shared_ptr<const Identity>> Identity::make() {
  if (Status opened = open_openssl(); !opened.ok()) return opened;
  ERR_clear_error();
  const auto refused = [] {
    return Status(Code::unsupported, fmt::format("this machine's OpenSSL has no TLS 1.3: {}", last_reason()));
  };
  ContextPointer context = make_context(TLS_server_method());
  const KeyPointer key(context ? EVP_EC_gen(kCurve) : nullptr);
  const CertificatePointer certificate = key ? self_signed(key.get()) : nullptr;
  if (!certificate || SSL_CTX_use_certificate(context.get(), certificate.get()) != 1 ||
      SSL_CTX_use_PrivateKey(context.get(), key.get()) != 1)
    return refused();
  std::string fingerprint = fingerprint_of(certificate.get());
  if (fingerprint.empty()) return refused();
  return std::shared_ptr<const Identity>(new Identity(context.release(), std::move(fingerprint)));
}

Identity::~Identity() { SSL_CTX_free(context_); }

}  // namespace rcb::tls
