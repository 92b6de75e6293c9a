#include "server/net/hello.hpp"

#include <fmt/format.h>

#include "server/net/data_directory.hpp"

namespace rcb::net {

Result<Hello> read_hello(const Frame& frame, const std::string* token) {
  const auto bad = [](const std::string& what) { return Status(Code::protocol_error, what); };
  if (frame.header.type == wire::FrameType::goodbye) return Status(Code::unavailable, "");
  if (frame.header.type != wire::FrameType::hello) return bad("the first frame must be hello");
  const auto protocol = wire::integer_field(frame.json, "protocol", 1, 1 << 16);
  if (!protocol.ok()) return bad("hello: " + protocol.status().message());
  if (*protocol != wire::kProtocolVersion)
    return bad(fmt::format("hello: protocol {} isn't spoken here, {} is", *protocol, wire::kProtocolVersion));
  const auto client = wire::string_field(frame.json, "client", 256);
  if (!client.ok()) return bad("hello: " + client.status().message());
  const auto text = wire::string_field(frame.json, "session", 16);
  if (!text.ok()) return bad("hello: " + text.status().message());
  const auto session = wire::parse_hex64(*text);
  if (!session.ok()) return bad("hello: " + session.status().message());
  if (token != nullptr) {
    const auto shown = wire::string_field(frame.json, "token", 256);
    if (!shown.ok() || !same_secret(*shown, *token))
      return Status(Code::not_authorised, shown.ok() ? "the token is wrong" : "a token is needed over TCP",
                    "it is the content of the file 'token' in the service's data directory");
  }
  return Hello{*client, wire::hex64(*session)};
}

}  // namespace rcb::net
