#include "server/net/sockets/hello.hpp"

#include <utility>

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include "common/auth/proof.hpp"
#include "common/base/text.hpp"

namespace rcb::net {
namespace {

constexpr std::size_t kClientBytesMax = 256;

Status bad(const std::string& what) { return {Code::protocol_error, "hello: " + what}; }

}  // namespace

wire::Json Door::welcome(const std::string& nonce) const {
  wire::Json json{{"server", "rcbd"},
                  {"protocol", wire::kProtocolVersion},
                  {"authentication", asks_for_token() ? auth::kMethod : "none"},
                  {"limits", {{"hello_seconds", options_.hello_seconds}}}};
  if (asks_for_token()) json["nonce"] = nonce;
  return json;
}

awaitable<Result<Hello>> Door::greet(std::shared_ptr<Connection> connection) {
  const Lobby::Place place(waiting_, *connection);
  const std::string nonce = auth::random_nonce();
  const TimePoint end = now() + duration_of(options_.hello_seconds);
  connection->limit_reading(end);
  Result<Frame> frame = co_await exchange_greetings(*connection, nonce, end);
  connection->limit_reading(TimePoint::max());
  if (frame.ok()) co_return read_hello(*frame, {options_.listener, nonce, "", "", connection->certificate()});
  if (frame.status().code() == Code::unavailable) co_return Status(Code::unavailable, "");
  if (frame.status().code() == Code::deadline_exceeded) co_return Status(Code::protocol_error, "no hello came in time");
  co_return frame.status();
}

awaitable<Result<Frame>> Door::exchange_greetings(Connection& connection, const std::string& nonce,
                                                  TimePoint end) const {
  const auto& credentials = options_.credentials;
  if (credentials && credentials->network() == Network::encrypted && connection.off_loopback()) {
    const Status encrypted = co_await connection.encrypt(*credentials->identity, end);
    if (!encrypted.ok()) spdlog::debug("{}: {}", options_.listener, encrypted.message());
    if (!encrypted.ok()) co_return encrypted;
  }
  connection.send(wire::FrameType::welcome, 0, welcome(nonce));
  co_return co_await connection.read_frame(wire::kBytesBeforeHelloMax - wire::kHeaderBytes, 0);
}

Result<Hello> Door::read_hello(const Frame& frame, auth::Opening opening) const {
  if (frame.header.type == wire::FrameType::goodbye) return Status(Code::unavailable, "");
  if (frame.header.type != wire::FrameType::hello) return bad("the first frame must be hello");
  const auto protocol = wire::integer_field(frame.json, "protocol", 1, 1 << 16);
  if (!protocol.ok()) return bad(protocol.status().message());
  if (*protocol != wire::kProtocolVersion)
    return bad(fmt::format("protocol {} isn't spoken here, {} is", *protocol, wire::kProtocolVersion));
  const auto client = wire::string_field(frame.json, "client", kClientBytesMax);
  if (!client.ok()) return bad(client.status().message());
  if (has_controls(*client)) return bad("field 'client': a control character in the client's name");
  const auto text = wire::string_field(frame.json, "session", 16);
  if (!text.ok()) return bad(text.status().message());
  const auto session = wire::parse_hex64(*text);
  if (!session.ok()) return bad(session.status().message());
  Hello hello{*client, wire::hex64(*session), frame.header.request, {}};
  if (Status known = check_proof(frame.json, std::move(opening), hello); !known.ok()) return known;
  return hello;
}

Status Door::check_proof(const wire::Json& said, auth::Opening opening, Hello& hello) const {
  if (said.contains("token"))
    return {Code::not_authorised, "a token is never said: a client proves that it knows it",
            "whoever listened on the way has it now: start the service again, which makes a new one"};
  if (!asks_for_token()) return {};
  const char* hint = "it is in the file 'token' of the service's data directory; each start by hand makes a new one";
  const auto client_nonce = wire::string_field(said, "nonce", opening.service_nonce.size());
  const auto proof = wire::string_field(said, "proof", opening.service_nonce.size());
  if (!client_nonce.ok() || !proof.ok() || !auth::is_nonce(*client_nonce))
    return {Code::not_authorised, "a proof of the service's token is needed over TCP", hint};
  opening.client_nonce = *client_nonce;
  opening.session = hello.session;
  const std::string& token = options_.credentials->token;
  if (!auth::same_secret(*proof, auth::proof(auth::Role::client, token, opening)))
    return {Code::not_authorised,
            opening.certificate.empty() ? "the client's token is not the service's"
                                        : "the client's token is not the service's, or the client has seen another "
                                          "certificate: then somebody sits between",
            hint};
  hello.proof = auth::proof(auth::Role::service, token, opening);
  return {};
}

void Door::let_in(Connection& connection, const Hello& hello, wire::Json reply) {
  reply["session"] = hello.session;
  if (!hello.proof.empty()) reply["proof"] = hello.proof;
  connection.send(wire::FrameType::reply, hello.request, reply);
}

}  // namespace rcb::net
