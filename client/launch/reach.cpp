#include "client/launch/reach.hpp"

#include <ctime>

#include <fmt/format.h>

#include "client/lib/connect/endpoint.hpp"
#include "client/lib/connect/retry.hpp"
#include "common/files/endpoint_lock.hpp"

namespace rcb::launch {
namespace {

constexpr double kReturnSeconds = 5;

// Which of the endpoints to try has a service that is about to be restarted; empty: none.
std::string returning(const std::string& given) {
  const auto endpoints = client::endpoints_to_try(given);
  if (!endpoints) return "";
  for (const client::Endpoint& endpoint : *endpoints)
    if (const auto holder = endpoint_holder(endpoint.text()))
      if (holder->start_at_unix < static_cast<double>(std::time(nullptr)) + kReturnSeconds) return endpoint.text();
  return "";
}

}  // namespace

Result<client::Client> connect_awaiting_restart(const client::ConnectOptions& options) {
  client::Retry retry(kReturnSeconds);
  for (;;) {
    auto client = client::Client::connect(options);
    if (client || client.status().code() != Code::unavailable) return client;
    const std::string where = returning(options.endpoint);
    if (where.empty()) return client;
    if (!retry.wait(fmt::format("the service at {}, which is being started again", where), options.on_notice))
      return client;
  }
}

}  // namespace rcb::launch
