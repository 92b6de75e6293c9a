// Door: how a connection begins, the same at the endpoint and at the ranks' own listeners: TLS, welcome, hello, reply.
//
// Invariants
// 1. Before hello a client is told only what it needs for its hello.
// 2. Over TCP both sides prove that they know the token (common/auth/proof.hpp); neither sends it.
// 3. Where the client may be on another machine, they do so over TLS, unless the owner trusts the network.
// 4. Connections that haven't said hello wait in a lobby of their own, so that no number of silent connections keeps
//    other clients out.
// Everything runs on the I/O thread.
#pragma once

#include <memory>
#include <optional>
#include <string>

#include "common/base/status.hpp"
#include "common/wire/limits.hpp"
#include "server/net/sockets/connection.hpp"
#include "server/net/sockets/credentials.hpp"
#include "server/net/sockets/lobby.hpp"

namespace rcb::net {

// What a client said in its hello, and the service's proof for the reply.
struct Hello {
  std::string client;
  std::string session;  // 16 hex digits
  std::uint64_t request = 0;
  std::string proof;  // the service's; empty if no token is required
};

struct DoorOptions {
  std::string listener;                    // to which proofs are bound: "endpoint" or "rank R"
  std::optional<Credentials> credentials;  // none on a Unix socket, where the kernel tells the peer's user
  double hello_seconds = wire::kHelloSecondsMax;
  std::size_t waiting_max = wire::kBeforeHelloMax;  // connections that haven't said hello
};

class Door {
 public:
  explicit Door(DoorOptions options) : options_(std::move(options)) {
    RCB_CHECK(!asks_for_token() || !options_.credentials->token.empty(), "a listener asks for a token and has none");
  }
  Door(const Door&) = delete;
  Door& operator=(const Door&) = delete;

  bool asks_for_token() const { return options_.credentials.has_value(); }
  // Encrypts the connection if need be, sends the welcome and reads the hello. Errors: protocol_error (also if none
  // comes in time), too_large, not_authorised; unavailable without a message if the client left, gave way to a newer
  // one, said goodbye or failed at TLS.
  awaitable<Result<Hello>> greet(std::shared_ptr<Connection> connection);
  // Answers the hello; from here on the client is admitted.
  static void let_in(Connection& connection, const Hello& hello, wire::Json reply);
  // Closes the connections that haven't said hello.
  void close() { waiting_.close(); }

 private:
  wire::Json welcome(const std::string& nonce) const;
  awaitable<Result<Frame>> exchange_greetings(Connection& connection, const std::string& nonce, TimePoint end) const;
  Result<Hello> read_hello(const Frame& frame, auth::Opening opening) const;
  // Checks the client's proof of the token and puts the service's own into `hello`.
  Status check_proof(const wire::Json& said, auth::Opening opening, Hello& hello) const;

  DoorOptions options_;
  Lobby waiting_{options_.waiting_max,
                 {Code::unavailable, "too many connections haven't said hello, and this was the oldest", "try again"}};
};

}  // namespace rcb::net
