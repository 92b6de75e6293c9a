// Proofs: how a client and a service that know the same token convince each other of it without saying it
// (HMAC-SHA256, RFC 2104, over what both know of the connection).
//
// Invariants
// 1. A proof holds for one role, one listener, one session and one pair of nonces, of which each side draws its own
// anew
//    for every connection. So what was overheard proves nothing later, nothing at another listener, and nothing to the
//    one who sent it.
// 2. Secrets are compared in a time that doesn't depend on where they differ.
//
// Who stands between the two and passes everything on is not found out: that takes an encrypted connection.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace rcb::auth {

inline constexpr std::string_view kMethod = "hmac-sha256";  // as a welcome names it

enum class Role { client, service };

// What both sides know of a connection before they trust each other.
struct Opening {
  std::string listener;  // "endpoint", or a rank's own: "rank R"
  std::string service_nonce;
  std::string client_nonce;
  std::string session;  // 16 hex digits
};

// That `role` knows the token: 64 hex digits. The nonces must be some (is_nonce).
std::string proof(Role role, std::string_view token, const Opening& opening);

std::string random_nonce();
// 64 lower-case hex digits.
bool is_nonce(std::string_view text);

// `bytes` of the kernel's randomness as hex digits.
std::string random_hex(std::size_t bytes);
// In a time that doesn't depend on where they differ.
bool same_secret(std::string_view a, std::string_view b);

}  // namespace rcb::auth
