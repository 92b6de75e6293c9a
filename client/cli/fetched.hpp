// Particles as the service hands them out, in id order, and the CSV files of their parts.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

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

// One CSV a part, part-0.csv and so on; appends their paths to `files`. The directory exists.
Status write_part_files(const Fetched& set, int parts, const std::string& directory, nlohmann::ordered_json& files);

}  // namespace rcb::cli
