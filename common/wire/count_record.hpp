// CountRecord: what a solver counted by the cuts that it knows, in place of the positions of a step. It travels as the
// bulk of a request `count` (PROTOCOL.md, "Counts"): a head of fixed size, then a row for each part that has particles.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/base/wide.hpp"

namespace rcb::wire {

struct WeightCount {
  int scale = 0;  // a load is the sum of weights, each times 2^scale, rounded down
  double least = 0;
  double greatest = 0;
  std::uint64_t as_zero = 0;  // weights above 0 that count as 0 in this scale
  std::vector<u128> loads;    // by entry of CountRecord::parts; any bits where another scale is due
};

struct CountRecord {
  std::int64_t step = 0;
  std::uint64_t incarnation = 0;
  std::uint64_t epoch = 0;  // of the cuts that it counted by
  std::uint64_t hash = 0;
  std::uint64_t n = 0;
  std::uint64_t inserted = 0;            // particles that were not there at the step before
  std::uint64_t removed = 0;             // particles of the step before that are no more
  std::optional<std::uint64_t> id_sum;   // of mix64(id), mod 2^64; none: rows are ids
  std::optional<std::uint64_t> drifted;  // rows whose part is another than at the step before
  std::optional<double> step_seconds;    // the solver's computing time since its last step
  std::vector<std::int32_t> parts;       // that have particles, ascending
  std::vector<std::uint64_t> counts;     // of these
  std::optional<WeightCount> weights;

  bool flows() const { return inserted > 0 || removed > 0; }
};

// Bytes of a record of so many parts, at most.
std::uint64_t count_record_bytes_most(std::uint64_t parts);

std::string encode(const CountRecord& record);
// Whatever is wrong with the record by itself is found here. Errors: invalid_argument.
Result<CountRecord> decode_count_record(std::span<const std::byte> bytes);

}  // namespace rcb::wire
