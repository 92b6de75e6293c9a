// count(): what a step tells of its particles, in one pass over them: the part of each row, and of every part how many
// particles and how much weight. The sums are of integers, so those of several processes add up to the same bits.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/base/status.hpp"
#include "common/base/wide.hpp"
#include "common/cuts/cuts.hpp"

namespace rcb::cuts {

struct CountOptions : OwnerOptions {
  std::span<const double> weights{};      // [count]; empty: none
  int scale = 0;                          // of the loads: the exponent of an ExactScale
  std::optional<std::uint64_t> id_key{};  // sums ids with it, and checks them; without ids nothing is summed
};

struct Count {
  std::uint64_t n = 0;
  std::vector<std::uint64_t> counts;  // by part
  // By part, exact, in the scale that was asked; empty without weights. They say nothing where a weight is so great
  // that a smaller scale is due.
  std::vector<u128> loads;
  double least = 0, greatest = 0;     // weight; 0 without any
  std::uint64_t weights_as_zero = 0;  // likewise: particles whose weight is above 0 and counts as 0 in this scale
  std::uint64_t id_sum = 0;           // of mix64(id + key), mod 2^64
  std::uint64_t drifted = 0;          // rows whose part is not that of last_part; 0 without
};

// Sets part[i] to the part of position i; `part` may be the array of last_part. Errors: invalid_argument (lengths,
// dims; weights, ids), not_finite; both name the first particle with such values.
Result<Count> count(const Cuts& cuts, const Positions& positions, const CountOptions& options,
                    std::span<std::int32_t> part);

}  // namespace rcb::cuts
