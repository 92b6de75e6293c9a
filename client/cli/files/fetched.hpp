// Particles as the service returns them, in id order.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "client/lib/client.hpp"
#include "common/base/status.hpp"

namespace rcb::cli {

// Views into the arrays of the reply.
struct Fetched {
  std::vector<std::span<const double>> axes;
  std::span<const std::int64_t> id;
  std::optional<std::span<const double>> weight;
  std::span<const std::int32_t> part;
};

// Checks the arrays of `fetch`, all of one length. Errors: protocol_error.
Result<Fetched> fetched(const client::Reply& reply);

}  // namespace rcb::cli
