// Connects to a service in one line.
#pragma once

#include <string>

#include "client/lib/client.hpp"
#include "common/base/status.hpp"

namespace rcb::launch {

// endpoint: empty: as the client library finds it. Errors: those of Client::connect.
inline Result<client::Client> reach(const std::string& endpoint, const std::string& name, double deadline_seconds = 5) {
  client::ConnectOptions options;
  options.endpoint = endpoint;
  options.name = name;
  options.deadline_seconds = deadline_seconds;
  return client::Client::connect(options);
}

}  // namespace rcb::launch
