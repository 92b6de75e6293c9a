// Connects to a service in one line.
#pragma once

#include <string>

#include "client/lib/client.hpp"
#include "common/base/status.hpp"

namespace rcb::launch {

// For who looks after a service, or has one of its own that nobody starts again: where it has gone, that is told at
// once. endpoint: empty: as the client library finds it. Errors: those of Client::connect.
inline Result<client::Client> reach(const std::string& endpoint, const std::string& name, double deadline_seconds = 5) {
  client::ConnectOptions options;
  options.endpoint = endpoint;
  options.name = name;
  options.deadline_seconds = deadline_seconds;
  options.outlive = false;
  return client::Client::connect(options);
}

// Client::connect for a user's command: where a supervisor is about to start the service again, that is waited for, for
// a few seconds; options.on_notice hears of it.
Result<client::Client> reach_returning(const client::ConnectOptions& options);

}  // namespace rcb::launch
