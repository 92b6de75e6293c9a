#include "server/scene/count.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include <fmt/format.h>

#include "common/base/exact_scale.hpp"
#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"

namespace rcb::scene {
namespace {

// An array of so many columns, by rows.
template <typename T>
bool take(const wire::Array& array, const char* name, const char* dtype, std::size_t columns, std::vector<T>& into) {
  if (array.name != name || array.dtype != dtype) return false;
  into.resize(array.bytes.size() / sizeof(T));  // of a message: its sizes fit its shapes
  if (!into.empty()) std::memcpy(into.data(), array.bytes.data(), into.size() * sizeof(T));
  return array.shape.size() == (columns == 1 ? 1U : 2U) && (columns == 1 || array.shape[1] == columns);
}

Status odd(std::string what) { return {Code::invalid_argument, "count: " + std::move(what)}; }

Status check_parts(const CountRecord& record) {
  u128 sum = 0;
  for (std::size_t k = 0; k < record.parts.size(); ++k) {
    const std::int32_t part = record.parts[k];
    if (part < 0 || part >= wire::kPartsMax || (k > 0 && part <= record.parts[k - 1]))
      return odd(
          fmt::format("part {} after part {}: parts must be >= 0 and ascend", part, k > 0 ? record.parts[k - 1] : -1));
    if (record.counts[k] == 0) return odd(fmt::format("no particles in part {}, which is listed", part));
    sum += record.counts[k];
  }
  if (sum == record.n) return {};
  return odd(fmt::format("the parts have {} particles together, and n is {}", static_cast<double>(sum), record.n));
}

Status check_weights(const CountRecord& record, const WeightCount& weights) {
  const auto right = [](double w) { return std::isfinite(w) && w >= 0; };
  if (!right(weights.least) || !right(weights.greatest) || weights.least > weights.greatest)
    return odd(fmt::format("weights from {} to {}: they must be finite and >= 0", weights.least, weights.greatest));
  if (weights.as_zero > record.n) return odd(fmt::format("{} weights as zero of {}", weights.as_zero, record.n));
  return {};
}

Result<std::uint64_t> hex_field(const wire::Json& request, const char* name) {
  const auto text = wire::string_field(request, name, 16);
  if (!text.ok()) return text.status();
  auto value = wire::parse_hex64(*text);
  if (!value.ok()) return odd(fmt::format("field '{}': {}", name, value.status().message()));
  return value;
}

}  // namespace

Result<CountRecord> read_count(const wire::Json& request, const std::vector<wire::Array>& arrays) {
  CountRecord record;
  wire::FieldReader fields(request);
  record.session = fields.text("session", 64);
  record.step = fields.integer("step", 0, wire::kStepMax);
  record.epoch = static_cast<std::uint64_t>(fields.integer("epoch", 0, wire::kIntegerMax));
  record.n = fields.particles("n");
  record.inserted = fields.particles("inserted");
  record.removed = fields.particles("removed");
  if (fields.has("drifted")) record.drifted = fields.particles("drifted");
  if (fields.has("step_seconds"))
    record.step_seconds = fields.number_or("step_seconds", 0, std::numeric_limits<double>::max(), 0);
  if (!fields.ok()) return fields.status();
  for (const auto& [name, into] : {std::pair{"incarnation", &record.incarnation}, {"hash", &record.hash}}) {
    const auto value = hex_field(request, name);
    if (!value.ok()) return value.status();
    *into = *value;
  }
  if (fields.has("id_sum")) {
    const auto sum = hex_field(request, "id_sum");
    if (!sum.ok()) return sum.status();
    record.id_sum = *sum;
  }
  if (record.drifted > record.n) return odd(fmt::format("{} of {} particles drifted", *record.drifted, record.n));
  const bool weighted = fields.has("scale");
  if (arrays.size() != (weighted ? 3U : 2U) || !take(arrays[0], "part", "<i4", 1, record.parts) ||
      !take(arrays[1], "count", "<u8", 1, record.counts) || record.parts.size() != record.counts.size())
    return odd("expected arrays 'part' <i4 and 'count' <u8 of the same length, and with weights 'load'");
  if (Status status = check_parts(record); !status.ok()) return status;
  if (!weighted) return record;
  WeightCount weights;
  weights.scale = static_cast<int>(fields.integer("scale", -kScaleMost, kScaleMost));
  weights.least = fields.number_or("least", 0, std::numeric_limits<double>::max(), 0);
  weights.greatest = fields.number_or("greatest", 0, std::numeric_limits<double>::max(), 0);
  weights.as_zero = fields.particles("weights_as_zero");
  if (!fields.ok()) return fields.status();
  std::vector<std::uint64_t> halves;
  if (!take(arrays[2], "load", "<u8", 2, halves) || halves.size() != 2 * record.parts.size())
    return odd("expected an array 'load' <u8 of the shape [parts, 2]");
  for (std::size_t k = 0; k < record.parts.size(); ++k)
    weights.loads.push_back(u128{halves[2 * k]} | u128{halves[2 * k + 1]} << 64U);
  if (Status status = check_weights(record, weights); !status.ok()) return status;
  record.weights = std::move(weights);
  return record;
}

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
