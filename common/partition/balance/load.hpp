// Room `balance`: weights, quotas, loads and errors. All sums are of integers, so that they are bit-identical for any
// number of ranks; whatever is added here must keep to that.
//
// Loads, targets, quotas and the error, in exact integers: no decision depends on a floating-point sum.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/base/exact_scale.hpp"
#include "common/comm/comm.hpp"
#include "common/particles/block_ranges.hpp"

namespace rcb::partition {

// Part sizes as exact integers, each at least 1; all 1 if `sizes` is empty or all sizes are equal.
std::vector<u128> exact_sizes(std::span<const double> sizes, int parts);

// quotas[p]: how many particles a partition of n gives part p: differences of floor(n * S_p / S), S_p the prefix sums
// of the sizes.
std::vector<std::uint64_t> quotas(std::uint64_t n, std::span<const double> sizes, int parts);

// floor(n * part / whole), exactly; part <= whole, whole > 0.
std::uint64_t floor_share(std::uint64_t n, u128 part, u128 whole);

// The range of the weights; empty if there are none. Local.
inline particles::Range weight_range(const particles::ParticleView& particles) {
  return particles::range_of({particles.weight, particles.weight == nullptr ? 0 : particles.count});
}
// The greatest weight, from the range of all ranks' weights; nullopt where weights don't count: absent on all ranks,
// all equal, or all zero. Local.
inline std::optional<double> greatest_weight(const particles::Range& all) {
  return all.lo < all.hi ? std::optional(all.hi) : std::nullopt;
}

// Particles and, where weights count, their weight in the scene's scale.
struct Load {
  std::uint64_t count = 0;
  u128 weight = 0;

  Load operator+(const Load& other) const { return {count + other.count, weight + other.weight}; }
  Load operator-(const Load& other) const { return {count - other.count, weight - other.weight}; }
  void operator+=(const Load& other) { *this = *this + other; }
};

// Load per part and what follows from it. Weighted loads are exact integers in the scene's scale. In the formulas W is
// the sum of all loads, s a part's size and S the sum of all sizes.
struct LoadSummary {
  std::vector<std::uint64_t> counts;  // particles per part
  std::vector<u128> loads;            // exact; equal to counts where nothing is weighted
  bool weighted = false;              // false where weights are absent, all equal or all zero
  int scale_exponent = 0;             // a load in the user's unit is loads[p] * 2^-scale_exponent
  std::uint64_t weights_as_zero = 0;  // particles whose weight is above 0, but so far below the greatest that it counts
                                      // as 0 in this scale
  double error = 0;                   // max |load*S - W*s| / (W*s), rounded once
  double imbalance = 1;               // max load*S / (W*s), rounded once
  std::vector<double> part_errors;    // likewise of each part
  std::vector<double> targets;        // n/P, n*s_p/S or the share of the total weight, rounded once
  std::vector<double> load_values;    // loads in the user's unit, rounded once
};

// Collective (one reduction without weights, three with; two if all are equal).
//   part  [particles.count], each 0..parts-1
LoadSummary summarise_loads(comm::Comm& comm, const particles::ParticleView& particles,
                            std::span<const std::int32_t> part, std::span<const double> sizes, int parts);
// The summary after some particles have changed their part, from the summary before; n and all weights are unchanged.
// Collective (one reduction). Cost in proportion to the parts and to the changed particles.
//   part  [particles.count], before the change
//   slot  local particles that change their part; to: their new parts
LoadSummary moved_loads(comm::Comm& comm, const particles::ParticleView& particles, const LoadSummary& before,
                        std::span<const std::int32_t> part, std::span<const std::uint64_t> slot,
                        std::span<const std::int32_t> to, std::span<const double> sizes);
// Local: the summary of known counts, nothing weighted.
LoadSummary summarise_counts(std::vector<std::uint64_t> counts, std::span<const double> sizes);
// Local: the summary of known counts and weighted loads, in the scale of this exponent.
LoadSummary summarise_weighted(std::vector<std::uint64_t> counts, std::vector<u128> loads, int scale_exponent,
                               std::uint64_t weights_as_zero, std::span<const double> sizes);

// numerator / denominator rounded once to the nearest double (ties to even); denominator > 0.
double quotient(u128 numerator, u128 denominator);

}  // namespace rcb::partition
