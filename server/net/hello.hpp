// Hello: the first words of a client, the same on the control socket and on the ranks' data sockets.
#pragma once

#include <string>

#include "common/base/status.hpp"
#include "server/net/connection.hpp"

namespace rcb::net {

struct Hello {
  std::string client;
  std::string session;  // 16 hex digits
};

// token: what the client must show; null where none is needed.
// Errors: protocol_error, not_authorised; unavailable without a message where the client said goodbye instead.
Result<Hello> read_hello(const Frame& frame, const std::string* token);

}  // namespace rcb::net
