// Loads, targets and errors. A product of a load and a sum of part sizes has up to 254 bits.
#include "common/partition/balance/load.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include <boost/multiprecision/cpp_int.hpp>

#include "common/base/count_groups.hpp"
#include "common/comm/wide_sum.hpp"
#include "common/partition/balance/bounds.hpp"

namespace rcb::partition {
namespace {

using Wide = boost::multiprecision::uint512_t;

// numerator / denominator * 2^exponent, rounded once (ties to even), subnormal results too. Both below 2^256; the
// denominator, where the exponent is that of a scale (at least -1300), below 2^128.
double rounded(const Wide& numerator, const Wide& denominator, int exponent = 0) {
  if (numerator == 0) return 0;
  if (exponent == 0 && msb(numerator) < 53 && msb(denominator) < 53)  // doubles hold both
    return static_cast<double>(static_cast<std::uint64_t>(numerator)) /
           static_cast<double>(static_cast<std::uint64_t>(denominator));
  // At most 56 bits of the quotient, of which the last is set if anything is left. It is so far below the last bit of a
  // double, at least two places below that of a subnormal one, that it only says which way to round.
  const int most = 55 + static_cast<int>(msb(denominator)) - static_cast<int>(msb(numerator));
  const int shift = std::min(most, 1076 + exponent);
  Wide whole;
  Wide rest;
  divide_qr(shift > 0 ? Wide(numerator << shift) : numerator, shift < 0 ? Wide(denominator << -shift) : denominator,
            whole, rest);
  return std::ldexp(static_cast<double>(static_cast<std::uint64_t>(whole) | (rest == 0 ? 0U : 1U)), exponent - shift);
}

// With what follows from counts and loads: error, imbalance, targets.
LoadSummary finished(LoadSummary summary, std::span<const double> sizes) {
  const std::vector<u128> shares = exact_sizes(sizes, static_cast<int>(summary.loads.size()));
  const u128 all = std::accumulate(shares.begin(), shares.end(), u128{0});
  const u128 total = std::accumulate(summary.loads.begin(), summary.loads.end(), u128{0});
  for (auto* of_parts : {&summary.part_errors, &summary.targets, &summary.load_values})
    of_parts->assign(shares.size(), 0.0);
  summary.error = 0;
  summary.imbalance = total == 0 ? 1 : 0;
  for (std::size_t p = 0; p < shares.size() && total > 0; ++p) {
    const Wide has = Wide(summary.loads[p]) * all;
    const Wide should = Wide(total) * shares[p];
    summary.part_errors[p] = rounded(has > should ? has - should : should - has, should);
    // Rounding is monotonic: the maximum of the rounded errors is the maximum error, rounded.
    summary.error = std::max(summary.error, summary.part_errors[p]);
    summary.imbalance = std::max(summary.imbalance, rounded(has, should));
    summary.targets[p] = rounded(should, Wide(all), -summary.scale_exponent);
    summary.load_values[p] = rounded(Wide(summary.loads[p]), Wide(1), -summary.scale_exponent);
  }
  return summary;
}

}  // namespace

std::vector<u128> exact_sizes(std::span<const double> sizes, int parts) {
  std::vector<u128> exact(static_cast<std::size_t>(parts), u128{1});
  if (sizes.empty() || std::ranges::all_of(sizes, [&](double size) { return size == sizes[0]; })) return exact;
  RCB_CHECK(sizes.size() == exact.size(), "a size for each part");
  const ExactScale scale(*std::ranges::max_element(sizes), sizes.size());
  // A size too small for the common scale counts as 1, not 0, so that every part has a target.
  for (std::size_t p = 0; p < exact.size(); ++p) exact[p] = std::max(scale(sizes[p]), u128{1});
  return exact;
}

std::vector<std::uint64_t> quotas(std::uint64_t n, std::span<const double> sizes, int parts) {
  const std::vector<u128> exact = exact_sizes(sizes, parts);
  const u128 all = std::accumulate(exact.begin(), exact.end(), u128{0});
  std::vector<std::uint64_t> result(exact.size());
  u128 running = 0;
  for (std::size_t p = 0; p < exact.size(); ++p) result[p] = floor_share(n, running += exact[p], all);
  std::adjacent_difference(result.begin(), result.end(), result.begin());
  return result;
}

std::uint64_t floor_share(std::uint64_t n, u128 part, u128 whole) {
  if ((part >> 64U) == 0) return static_cast<std::uint64_t>(u128{n} * part / whole);
  return static_cast<std::uint64_t>(Wide(n) * part / whole);
}

LoadSummary summarise_counts(std::vector<std::uint64_t> counts, std::span<const double> sizes) {
  LoadSummary summary;
  summary.loads.assign(counts.begin(), counts.end());
  summary.counts = std::move(counts);
  return finished(std::move(summary), sizes);
}

LoadSummary summarise_weighted(std::vector<std::uint64_t> counts, std::vector<u128> loads, int scale_exponent,
                               std::uint64_t weights_as_zero, std::span<const double> sizes) {
  return finished({.counts = std::move(counts),
                   .loads = std::move(loads),
                   .weighted = true,
                   .scale_exponent = scale_exponent,
                   .weights_as_zero = weights_as_zero},
                  sizes);
}

LoadSummary summarise_loads(comm::Comm& comm, const particles::ParticleView& particles,
                            std::span<const std::int32_t> part, std::span<const double> sizes, int parts) {
  RCB_CHECK(part.size() == particles.count && parts >= 1, "a part for each particle");
  const auto count = static_cast<std::size_t>(parts);
  // One more sum: the number of ranks with weights, since a rank without particles doesn't know whether there are any.
  std::vector<std::uint64_t> counts = count_groups([&](std::size_t i) { return part[i]; }, count + 1, part.size());
  counts[count] = particles.weight != nullptr && particles.count > 0 ? 1 : 0;
  comm.all_sum(counts);
  const bool any_weights = counts[count] > 0;
  counts.pop_back();
  if (!any_weights) return summarise_counts(std::move(counts), sizes);
  particles::Range range = weight_range(particles);
  AllMinMax weights;
  weights.add(range.lo, range.hi);
  weights.reduce(comm);
  weights.take(range.lo, range.hi);
  const std::optional<double> greatest = greatest_weight(range);
  if (!greatest) return summarise_counts(std::move(counts), sizes);
  const ExactScale scale(*greatest, std::accumulate(counts.begin(), counts.end(), std::uint64_t{0}));
  std::vector<u128> loads(count + 1, u128{0});  // the last one counts the weights that are too small
  for (std::size_t i = 0; i < particles.count; ++i) {
    const u128 weight = scale(particles.weight[i]);
    loads[static_cast<std::size_t>(part[i])] += weight;
    if (weight == 0 && particles.weight[i] > 0) ++loads[count];
  }
  comm::all_sum_wide(comm, loads);
  const auto as_zero = static_cast<std::uint64_t>(loads[count]);
  loads.pop_back();
  return summarise_weighted(std::move(counts), std::move(loads), scale.exponent(), as_zero, sizes);
}

LoadSummary moved_loads(comm::Comm& comm, const particles::ParticleView& particles, const LoadSummary& before,
                        std::span<const std::int32_t> part, std::span<const std::uint64_t> slot,
                        std::span<const std::int32_t> to, std::span<const double> sizes) {
  RCB_CHECK(slot.size() == to.size() && part.size() == particles.count, "a part for each particle");
  const std::size_t parts = before.counts.size();
  const ExactScale scale(before.scale_exponent);
  // Of every part: counts gained, counts lost, then weights gained, weights lost.
  std::vector<u128> change((before.weighted ? 4 : 2) * parts, 0);
  for (std::size_t k = 0; k < slot.size(); ++k) {
    const auto new_part = static_cast<std::size_t>(to[k]);
    const auto old_part = static_cast<std::size_t>(part[slot[k]]);
    ++change[new_part];
    ++change[parts + old_part];
    if (!before.weighted) continue;
    const u128 weight = scale(particles.weight[slot[k]]);
    change[2 * parts + new_part] += weight;
    change[3 * parts + old_part] += weight;
  }
  comm::all_sum_wide(comm, change);
  LoadSummary now = before;
  for (std::size_t p = 0; p < parts; ++p) {
    now.counts[p] += static_cast<std::uint64_t>(change[p] - change[parts + p]);
    now.loads[p] = before.weighted ? before.loads[p] + change[2 * parts + p] - change[3 * parts + p] : now.counts[p];
  }
  return finished(std::move(now), sizes);
}

double quotient(u128 numerator, u128 denominator) {
  RCB_CHECK(denominator > 0, "a quotient needs a denominator");
  return rounded(Wide(numerator), Wide(denominator));
}

}  // namespace rcb::partition
