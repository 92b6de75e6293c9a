// Door: how a connection begins, the same at the endpoint and at the ranks' own listeners: welcome, hello, reply.
//
// Invariants
// 1. Before hello nothing is told that a client doesn't need for it.
// 2. Over TCP both sides prove that they know the token (common/auth/proof.hpp), and nobody says it.
// 3. Who hasn't said hello is counted apart from who has, in a lobby, so no number of silent connections keeps others
//    out.
// Everything runs on the I/O thread.
#pragma once

#include <memory>
#include <optional>
#include <string>

#include "common/base/status.hpp"
#include "common/wire/limits.hpp"
#include "server/net/connection.hpp"
#include "server/net/lobby.hpp"

namespace rcb::net {

// What a client has said, and what it is to be told besides.
struct Hello {
  std::string client;
  std::string session;  // 16 hex digits
  std::uint64_t request = 0;
  std::string proof;  // ours; empty where none is asked for
};

struct DoorOptions {
  std::string listener;              // what proofs are bound to: "endpoint", or "rank R"
  std::optional<std::string> token;  // none on a Unix socket, where the kernel tells who the peer is
  double hello_seconds = wire::kHelloSecondsMax;
};

class Door {
 public:
  explicit Door(DoorOptions options) : options_(std::move(options)) {
    CHECK(!options_.token || !options_.token->empty(), "a listener asks for a token and has none");
  }
  Door(const Door&) = delete;
  Door& operator=(const Door&) = delete;

  bool asks_for_token() const { return options_.token.has_value(); }
  // Welcomes the client and hears its hello. Errors: protocol_error (also where it says nothing in time), too_large,
  // not_authorised; unavailable without a message where it left, gave way or said goodbye.
  awaitable<Result<Hello>> greet(std::shared_ptr<Connection> connection);
  // Answers the hello; from here on the client is in.
  static void let_in(Connection& connection, const Hello& hello, wire::Json reply);
  // Closes the connections that wait.
  void close() { waiting_.close(); }

 private:
  wire::Json welcome(const std::string& nonce) const;
  Result<Hello> read_hello(const Frame& frame, const std::string& nonce) const;
  // That the client knows the token, and, in `hello`, that we do.
  Status check_proof(const wire::Json& said, const std::string& nonce, Hello& hello) const;

  DoorOptions options_;
  Lobby waiting_{wire::kNewcomersMax,
                 {Code::unavailable, "too many connections haven't said hello, and this was the oldest", "try again"}};
};

}  // namespace rcb::net
