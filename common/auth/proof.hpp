// Proofs: how a client and a service that share a token show each other that they know it, without sending it
// (HMAC-SHA256, RFC 2104, over what both know of the connection).
//
// Invariants
// 1. A proof is valid for one role, one listener, one session and one pair of nonces; each side draws a new nonce for
//    every connection. So an overheard proof is worthless later, at another listener, or sent back to its sender.
// 2. On an encrypted connection it is valid for the certificate that each side sees there, too (RFC 5929,
//    tls-server-end-point). So a man in the middle, who must show a certificate of his own, is found out. On a
//    connection without TLS one who passes everything on is not.
// 3. Secrets are compared in a time that doesn't depend on where they differ.
//
// proof() and same_secret() need OpenSSL: open_openssl() must have succeeded (common/openssl).
//
// A token also says whether its service trusts the network (trusts_network). It reaches clients by a way that nobody on
// the network controls, so nobody there can talk a client out of encryption.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace rcb::auth {

inline constexpr std::string_view kMethod = "hmac-sha256";  // the method's name in a welcome frame

enum class Role { client, service };

// What both sides know of a connection before they trust each other.
struct Opening {
  std::string listener;  // "endpoint", or "rank R" for a rank's own listener
  std::string service_nonce;
  std::string client_nonce;
  std::string session;           // 16 hex digits
  std::string certificate = {};  // with TLS: the fingerprint of the service's, 64 hex digits; else empty
};

// The proof that `role` knows the token: 64 hex digits. Both nonces must satisfy is_nonce.
std::string proof(Role role, std::string_view token, const Opening& opening);

// Begins the tokens of services whose owner has said that nobody on the network reads or alters others' data. Between
// machines such a service and its clients speak without TLS, and all others with it.
inline constexpr std::string_view kTrustedNetworkPrefix = "trusted-network-";
bool trusts_network(std::string_view token);

std::string random_nonce();
// True for 64 lower-case hex digits.
bool is_nonce(std::string_view text);

// `bytes` random bytes from the kernel, as hex digits.
std::string random_hex(std::size_t bytes);
// In a time that doesn't depend on where they differ.
bool same_secret(std::string_view a, std::string_view b);

}  // namespace rcb::auth
