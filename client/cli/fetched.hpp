// Particles as the service hands them out, in id order.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "client/lib/client.hpp"
#include "common/base/status.hpp"

namespace rcb::cli {

// Views into the reply's arrays.
struct Fetched {
  std::vector<std::span<const double>> axes;
  std::span<const std::int64_t> id;
  std::span<const double> weight;  // empty: none
  std::span<const std::int32_t> part;
};

// The arrays of `fetch`, all of one length. Errors: protocol_error.
Result<Fetched> fetched(const client::Reply& reply);

}  // namespace rcb::cli
