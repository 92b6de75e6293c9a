#include "server/scene/count.hpp"

#include <algorithm>

#include <fmt/format.h>

#include "common/base/exact_scale.hpp"

namespace rcb::scene {
namespace {

Status odd(std::string what) { return {Code::invalid_argument, "count: " + std::move(what)}; }

}  // namespace

Status check_conserved(const std::string& scene, std::uint64_t had, std::uint64_t n, std::uint64_t inserted,
                       std::uint64_t removed) {
  if (removed <= had && n == had - removed + inserted) return {};
  const std::string change =
      inserted + removed > 0 ? fmt::format(", of which {} go and {} come", removed, inserted) : "";
  return {Code::not_conserved, fmt::format("{} particles brought, scene '{}' has {}{}", n, scene, had, change),
          "bring all particles once; say how many come ('inserted') and go ('removed'), or create the scene anew with "
          "replace"};
}

std::optional<int> scale_due(const WeightCount& weights, std::uint64_t n) {
  if (n == 0 || weights.least == weights.greatest) return std::nullopt;
  return ExactScale(weights.greatest, n).exponent();
}

bool sum_fits(std::span<const u128> loads) {
  constexpr u128 kSumMost = u128{1} << 127U;
  u128 sum = 0;
  return std::ranges::all_of(loads, [&sum](u128 load) { return load < kSumMost && (sum += load) < kSumMost; });
}

Result<partition::LoadSummary> loads_of(const CountRecord& record, int parts, std::span<const double> sizes) {
  if (!record.parts.empty() && record.parts.back() >= parts)
    return odd(fmt::format("part {}, and the scene has {} parts", record.parts.back(), parts));
  std::vector<std::uint64_t> counts(static_cast<std::size_t>(parts));
  for (std::size_t k = 0; k < record.parts.size(); ++k)
    counts[static_cast<std::size_t>(record.parts[k])] = record.counts[k];
  if (!record.weights || !scale_due(*record.weights, record.n))
    return partition::summarise_counts(std::move(counts), sizes);
  if (!sum_fits(record.weights->loads))
    return odd("loads of more than 127 bits, which no sum of weights in a scene's scale has");
  std::vector<u128> loads(counts.size());
  for (std::size_t k = 0; k < record.parts.size(); ++k)
    loads[static_cast<std::size_t>(record.parts[k])] = record.weights->loads[k];
  return partition::summarise_weighted(std::move(counts), std::move(loads), record.weights->scale,
                                       record.weights->as_zero, sizes);
}

}  // namespace rcb::scene
