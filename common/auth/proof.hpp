// Proofs: how a client and a service that share a token show each other that they know it, without sending it
// (HMAC-SHA256, RFC 2104, over what both know of the connection).
//
// Invariants
// 1. A proof is valid for one role, one listener, one session and one pair of nonces; each side draws a new nonce for
//    every connection. So an overheard proof is worthless later, at another listener, or sent back to its sender.
// 2. Secrets are compared in a time that doesn't depend on where they differ.
//
// A man in the middle who passes everything on is not detected: that takes an encrypted connection.
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
  std::string session;  // 16 hex digits
};

// The proof that `role` knows the token: 64 hex digits. Both nonces must satisfy is_nonce.
std::string proof(Role role, std::string_view token, const Opening& opening);

std::string random_nonce();
// True for 64 lower-case hex digits.
bool is_nonce(std::string_view text);

// `bytes` random bytes from the kernel, as hex digits.
std::string random_hex(std::size_t bytes);
// In a time that doesn't depend on where they differ.
bool same_secret(std::string_view a, std::string_view b);

}  // namespace rcb::auth
