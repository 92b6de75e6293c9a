#include "common/auth/proof.hpp"

#include <array>
#include <limits>
#include <span>
#include <vector>

#include <fmt/format.h>
#include <sys/random.h>

#include "common/base/check.hpp"
#include "common/openssl/openssl.hpp"

namespace rcb::auth {
namespace {

constexpr std::size_t kNonceBytes = 32;

std::string hex(std::span<const unsigned char> bytes) {
  std::string text;
  for (const unsigned char byte : bytes) text += fmt::format("{:02x}", byte);
  return text;
}

void require_openssl() {
  const Status opened = open_openssl();
  RCB_CHECK(opened.ok(), opened.message());
}

}  // namespace

std::string proof(Role role, std::string_view token, const Opening& opening) {
  RCB_CHECK(is_nonce(opening.service_nonce) && is_nonce(opening.client_nonce), "a proof over what is no nonce");
  RCB_CHECK(!token.empty() && token.size() <= std::numeric_limits<int>::max(), "a proof of no token");
  require_openssl();
  // Fields contain no newlines, so different openings always give different texts.
  std::string text = fmt::format("rcbd proof 1\n{}\n{}\n{}\n{}\n{}\n", role == Role::client ? "client" : "service",
                                 opening.listener, opening.service_nonce, opening.client_nonce, opening.session);
  if (!opening.certificate.empty()) text += opening.certificate + "\n";
  std::array<unsigned char, EVP_MAX_MD_SIZE> digest{};
  unsigned size = 0;
  const auto* made = HMAC(EVP_sha256(), token.data(), static_cast<int>(token.size()),
                          reinterpret_cast<const unsigned char*>(text.data()), text.size(), digest.data(), &size);
  RCB_CHECK(made != nullptr, "OpenSSL has no HMAC-SHA256");
  return hex(std::span(digest.data(), size));
}

bool trusts_network(std::string_view token) { return token.starts_with(kTrustedNetworkPrefix); }

std::string random_nonce() { return random_hex(kNonceBytes); }

bool is_nonce(std::string_view text) {
  return text.size() == 2 * kNonceBytes && text.find_first_not_of("0123456789abcdef") == std::string_view::npos;
}

std::string random_hex(std::size_t bytes) {
  std::vector<unsigned char> raw(bytes);
  RCB_CHECK(::getrandom(raw.data(), raw.size(), 0) == static_cast<ssize_t>(bytes), "the kernel gives no random bytes");
  return hex(raw);
}

bool same_secret(std::string_view a, std::string_view b) {
  require_openssl();
  return a.size() == b.size() && CRYPTO_memcmp(a.data(), b.data(), a.size()) == 0;
}

}  // namespace rcb::auth
