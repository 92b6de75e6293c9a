// Proofs against a vector that another program computed, and what a proof is bound to.
#include "common/auth/proof.hpp"

#include <set>

#include <gtest/gtest.h>

namespace rcb::auth {
namespace {

const std::string kToken(64, 'a');
const Opening kOpening{"rank 3", std::string(64, '1'), std::string(64, '2'), "00000000000000aa"};

// python3: hmac.new(b"a" * 64, f"rcbd proof 1\nclient\nrank 3\n{'1' * 64}\n{'2' * 64}\n00000000000000aa\n".encode(),
//                   "sha256").hexdigest()
TEST(Proof, IsThatOfAnotherProgram) {
  EXPECT_EQ(proof(Role::client, kToken, kOpening), "04be1f56d9fae1135196ccef46002f6a2f199958a8c7ebc99d64a434b82acf17");
  EXPECT_EQ(proof(Role::service, kToken, kOpening), "1ec1e490b463089501fc0b9715924beef304040336fdc5a8b0cf9cfdb4e6b442");
  Opening encrypted = kOpening;  // the text goes on with f"{'3' * 64}\n"
  encrypted.certificate = std::string(64, '3');
  EXPECT_EQ(proof(Role::client, kToken, encrypted), "f8623f16cc3768be54c477e9f3efa0f2ca92bae6756cfe950d27745d3b91c28e");
}

TEST(Proof, HoldsForOneOpeningAlone) {
  std::set<std::string> proofs{proof(Role::client, kToken, kOpening), proof(Role::service, kToken, kOpening),
                               proof(Role::client, std::string(64, 'b'), kOpening)};
  Opening other = kOpening;
  other.listener = "rank 4";
  proofs.insert(proof(Role::client, kToken, other));
  other.listener = "endpoint";
  proofs.insert(proof(Role::client, kToken, other));
  other = kOpening;
  std::swap(other.service_nonce, other.client_nonce);
  proofs.insert(proof(Role::client, kToken, other));
  other = kOpening;
  other.session = "00000000000000ab";
  proofs.insert(proof(Role::client, kToken, other));
  for (const char digit : {'3', '4'}) {
    other = kOpening;
    other.certificate = std::string(64, digit);
    proofs.insert(proof(Role::client, kToken, other));
  }
  EXPECT_EQ(proofs.size(), 9U);
}

TEST(Proof, NoncesAreFreshAndAreChecked) {
  const std::string nonce = random_nonce();
  EXPECT_TRUE(is_nonce(nonce));
  EXPECT_NE(random_nonce(), nonce);
  for (const std::string& wrong : {std::string(), nonce.substr(1), nonce + "0", std::string(64, 'A'),
                                   std::string(63, '1') + "\n", std::string(64, '\0')})
    EXPECT_FALSE(is_nonce(wrong)) << wrong;
}

TEST(Token, SaysWhetherTheNetworkIsTrusted) {
  EXPECT_TRUE(trusts_network("trusted-network-" + kToken));
  for (const std::string& token : {kToken, std::string(), kToken + "trusted-network-", std::string("trusted-network")})
    EXPECT_FALSE(trusts_network(token)) << token;
}

TEST(Secrets, AreComparedWhole) {
  EXPECT_TRUE(same_secret("abc", "abc"));
  for (const char* other : {"", "ab", "abd", "xbc", "abcd"}) EXPECT_FALSE(same_secret("abc", other)) << other;
  EXPECT_NE(random_hex(32), random_hex(32));
}

}  // namespace
}  // namespace rcb::auth
