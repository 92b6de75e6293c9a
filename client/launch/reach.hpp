// Short ways to connect to a service.
#pragma once

#include <string>

#include "client/lib/client.hpp"
#include "common/base/status.hpp"

namespace rcb::launch {

// For a supervisor, or for a program whose service nobody restarts: fails at once if the service has gone. endpoint,
// token: empty: as the client library finds them. Errors: those of Client::connect.
inline Result<client::Client> reach(const std::string& endpoint, const std::string& name, double deadline_seconds = 5,
                                    const std::string& token = {}) {
  client::ConnectOptions options;
  options.endpoint = endpoint;
  options.name = name;
  options.deadline_seconds = deadline_seconds;
  options.token = token;
  options.outlive = false;
  options.on_notice = [](const std::string&) {};
  return client::Client::connect(options);
}

// Client::connect for a user's command: if a supervisor is about to restart the service, waits a few seconds for that,
// and says so by options.on_notice.
Result<client::Client> connect_awaiting_restart(const client::ConnectOptions& options);

}  // namespace rcb::launch
