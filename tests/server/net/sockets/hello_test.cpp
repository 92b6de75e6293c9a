// How a connection begins: who is let in, what was overheard or passed on proves, and what silence does to others.
#include <functional>
#include <set>

#include <gtest/gtest.h>

#include "common/auth/proof.hpp"
#include "server/net/data/data_port.hpp"
#include "tests/server/net/harness.hpp"

namespace rcb::net::testing {
namespace {

using auth::Opening;
using auth::Role;
using wire::FrameType;
using wire::Json;

const std::string kToken(64, 'a');  // TestService::defaults()

Json hello_json(const Opening& opening, const std::string& proof) {
  return {{"protocol", 2},
          {"client", "c"},
          {"session", opening.session},
          {"nonce", opening.client_nonce},
          {"proof", proof}};
}

// Rank 2's own listener.
class Rank {
 public:
  explicit Rank(DataOptions options = {}) {
    options.rank = 2;
    options.credentials.token = kToken;
    port_ = std::make_unique<DataPort>(loop_, options);
    EXPECT_TRUE(port_->listen_unix(path()).ok());
    const auto bound = port_->listen_tcp("127.0.0.1:0");
    EXPECT_TRUE(bound.ok());
    if (bound.ok()) tcp_ = *bound;
    port_->start([](const SliceReport&) {});
    loop_.start();
  }
  ~Rank() { loop_.stop(); }
  std::string path() const { return directory_ / "s.2"; }
  const std::string& tcp() const { return tcp_; }

 private:
  Directory directory_;
  IoLoop loop_;
  std::unique_ptr<DataPort> port_;
  std::string tcp_;
};

TEST(Hello, OverTcpBothSidesProveThatTheyKnowTheToken) {
  TestService service;
  Client client = Client::on_tcp(service.tcp());
  const Received welcome = client.receive();
  EXPECT_EQ(welcome.json["authentication"], "hmac-sha256");
  EXPECT_EQ(welcome.json.size(), 5U) << "before hello nothing is told that hello doesn't need: " << welcome.json;
  const Opening opening{"endpoint", welcome.json["nonce"], auth::random_nonce(), kAnna};
  client.send(FrameType::hello, hello_json(opening, auth::proof(Role::client, kToken, opening)));
  const Received reply = client.receive();
  ASSERT_EQ(reply.type, FrameType::reply) << reply.json;
  EXPECT_EQ(reply.json["proof"], auth::proof(Role::service, kToken, opening));
  EXPECT_EQ(client.call("status").type, FrameType::reply);
}

TEST(Hello, WhatProvesNothingIsRefused) {
  TestService service;
  const Opening good{"endpoint", "", auth::random_nonce(), kAnna};
  const auto proof_with = [](const std::string& token, Role role = Role::client) {
    return [token, role](const Opening& opening) { return auth::proof(role, token, opening); };
  };
  const std::vector<std::function<Json(const Opening&)>> hellos{
      [](const Opening&) {
        return Json{{"protocol", 2}, {"client", "c"}, {"session", kAnna}};
      },
      [&](const Opening& o) { return hello_json(o, proof_with(std::string(64, 'b'))(o)); },
      [&](const Opening& o) { return hello_json(o, proof_with(kToken, Role::service)(o)); },  // sent back
      [&](const Opening& o) { return hello_json(o, proof_with(kToken)(o).substr(1)); },
      [&](const Opening& o) { return hello_json(o, proof_with(kToken)(o) + "0"); },
      [&](const Opening& o) { return hello_json(o, ""); },
      [&](const Opening& o) { return hello_json(o, kToken); },
      [&](const Opening& o) {
        Json json = hello_json(o, proof_with(kToken)(o));
        json["session"] = "00000000000000bb";
        return json;
      },
      [&](const Opening& o) {
        Json json = hello_json(o, proof_with(kToken)(o));
        json["nonce"] = o.service_nonce;
        return json;
      },
      [&](const Opening& o) {
        Json json = hello_json(o, proof_with(kToken)(o));
        json["nonce"] = 7;
        return json;
      },
      [&](const Opening& o) {
        Json json = hello_json(o, proof_with(kToken)(o));
        json["nonce"] = "x\ny";
        return json;
      }};
  for (std::size_t i = 0; i < hellos.size(); ++i) {
    Client client = Client::on_tcp(service.tcp());
    Opening opening = good;
    opening.service_nonce = client.receive().json["nonce"];
    client.send(FrameType::hello, hellos[i](opening));
    const Received refused = client.receive();
    EXPECT_EQ(refused.code(), "not_authorised") << i << ": " << refused.json;
    EXPECT_FALSE(refused.json.contains("proof"));
    EXPECT_TRUE(client.receive().ended);
  }
}

TEST(Hello, ATokenIsNeverSaid) {
  TestService service;
  for (const bool tcp : {true, false}) {
    Client client = tcp ? Client::on_tcp(service.tcp()) : service.connect();
    client.receive();
    client.send(FrameType::hello, {{"protocol", 2}, {"client", "c"}, {"session", kAnna}, {"token", kToken}});
    const Received refused = client.receive();
    EXPECT_EQ(refused.code(), "not_authorised");
    EXPECT_NE(refused.message().find("never said"), std::string::npos) << refused.message();
  }
}

TEST(Hello, AnOverheardHelloProvesNothingLater) {
  TestService service;
  std::set<std::string> nonces;
  Json overheard;
  for (int round = 0; round < 20; ++round) {
    Client client = Client::on_tcp(service.tcp());
    const std::string nonce = client.receive().json["nonce"];
    EXPECT_TRUE(nonces.insert(nonce).second) << "a nonce came twice";
    if (round == 0) {
      const Opening opening{"endpoint", nonce, auth::random_nonce(), kAnna};
      overheard = hello_json(opening, auth::proof(Role::client, kToken, opening));
    }
    client.send(FrameType::hello, overheard);
    EXPECT_EQ(client.receive().code(), round == 0 ? "" : "not_authorised");
  }
}

// Somebody who has taken the endpoint's port has a client answer the nonce of another listener, and the reverse.
TEST(Hello, AProofForOneListenerIsOfNoUseAtAnother) {
  TestService service;
  const Rank rank;
  for (const auto& [where, right] : {std::pair(rank.tcp(), "rank 2"), std::pair(service.tcp(), "endpoint")})
    for (const std::string asked : {"endpoint", "rank 2", "rank 1", "rank 20"}) {
      Client client = Client::on_tcp(where);
      EXPECT_EQ(client.hello("c", kAnna, kToken, asked).code(), asked == right ? "" : "not_authorised")
          << asked << " at " << right;
    }
}

TEST(Hello, NamesThatWouldForgeTheLogAreRefused) {
  TestService service;
  for (const char* name : {"two\nlines", "\x1b[2J", "\u009b2J", "bell\a"}) {
    Client client = service.connect();
    EXPECT_EQ(client.hello(name, kAnna).code(), "protocol_error") << name;
  }
  Client client = service.connect();
  EXPECT_EQ(client.hello("Größe 3, ζ", kAnna).type, FrameType::reply);
}

// At every listener: 300 that say nothing, or half a hello, and one who wants in.
TEST(Hello, SilenceKeepsNobodyOut) {
  ControlOptions options = TestService::defaults();
  options.hello_seconds = 600;  // far beyond this test: it must not be their deadline that frees the way
  options.sessions_max = 8;
  options.waiting_max = 64;
  TestService service(options);
  DataOptions data;
  data.hello_seconds = 600;
  data.connections_max = 8;
  data.waiting_max = 64;
  const Rank rank(data);
  const std::vector<std::function<Client()>> listeners{
      [&] { return Client::on_unix(service.path()); }, [&] { return Client::on_tcp(service.tcp()); },
      [&] { return Client::on_unix(rank.path()); }, [&] { return Client::on_tcp(rank.tcp()); }};
  const std::string half = frame(FrameType::hello, 1, R"({"protocol":1})").substr(0, 45);
  for (std::size_t i = 0; i < listeners.size(); ++i) {
    std::vector<Client> silent;
    for (int k = 0; k < 300; ++k) {
      silent.push_back(listeners[i]());
      if (k % 2 == 0) silent.back().send_bytes(half);
    }
    Client client = listeners[i]();
    const bool tcp = i % 2 == 1;
    EXPECT_EQ(client.hello("c", kAnna, tcp ? kToken : "", i < 2 ? "endpoint" : "rank 2").type, FrameType::reply) << i;
    EXPECT_EQ(silent[1].receive().type, FrameType::welcome);
    EXPECT_EQ(silent[1].receive().code(), "unavailable") << "who came first has given way, and was told so";
    EXPECT_EQ(silent[299].receive().type, FrameType::welcome);
  }
  // Those who are in don't wait for anybody, and count as what they are.
  Client witness = service.client("witness");
  EXPECT_EQ(witness.call("status").type, FrameType::reply);
}

}  // namespace
}  // namespace rcb::net::testing
