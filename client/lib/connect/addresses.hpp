// Where an endpoint is, and who listens there.
#pragma once

#include <vector>

#include <boost/asio/generic/stream_protocol.hpp>

#include "client/lib/connect/connection.hpp"
#include "client/lib/connect/endpoint.hpp"
#include "common/base/status.hpp"

namespace rcb::client {

using Address = boost::asio::generic::stream_protocol::endpoint;

// Errors: deadline_exceeded, unavailable (a name without an address).
Result<std::vector<Address>> addresses_of(const Endpoint& endpoint, const Deadline& deadline);

// Who serves this Unix socket. Any user can create one in a shared directory; only one served by this user or by root
// is trusted. Errors: not_authorised.
Status check_server(int handle, const Endpoint& endpoint);

}  // namespace rcb::client
