#include "server/scene/tally.hpp"

#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include "common/wire/limits.hpp"

namespace rcb::scene {
namespace {

Status cannot_add(std::size_t seat, const char* why) {
  return {Code::invalid_argument, fmt::format("the count of seat {}: {}", seat, why)};
}

struct PartSum {
  u128 count = 0;
  u128 load = 0;
};

// Loads in a scale that isn't due have any bits, so their sums may wrap.
void add_parts(const CountRecord& record, std::vector<PartSum>& parts) {
  if (!record.parts.empty()) parts.resize(std::max(parts.size(), static_cast<std::size_t>(record.parts.back()) + 1));
  for (std::size_t k = 0; k < record.parts.size(); ++k) {
    PartSum& sum = parts[static_cast<std::size_t>(record.parts[k])];
    sum.count += record.counts[k];
    if (record.weights) sum.load += record.weights->loads[k];
  }
}

// Rows in parts outside [first, end).
std::uint64_t strangers_of(const CountRecord& record, std::uint64_t first, std::uint64_t end) {
  std::uint64_t strangers = 0;
  for (std::size_t k = 0; k < record.parts.size(); ++k)
    if (const auto part = static_cast<std::uint64_t>(record.parts[k]); part < first || part >= end)
      strangers += record.counts[k];
  return strangers;
}

void add_weights(const CountRecord& record, CountRecord& all) {
  const WeightCount& weights = *record.weights;
  if (!all.weights) {
    all.weights = WeightCount{weights.scale, weights.least, weights.greatest, weights.as_zero, {}};
    return;
  }
  all.weights->least = std::min(all.weights->least, weights.least);
  all.weights->greatest = std::max(all.weights->greatest, weights.greatest);
  all.weights->as_zero += weights.as_zero;
}

}  // namespace

Result<CountRecord> Tally::sum(int scene_parts) const {
  CountRecord all = *records_.front();
  for (const auto& record : records_) all.sessions.push_back(session_key(record->session));
  if (records_.size() == 1) return all;
  all.n = all.bytes = all.inserted = all.removed = 0;
  all.id_sum = 0;
  all.drifted.reset();
  all.weights.reset();
  const auto first_part = [&](std::size_t seat) {
    return seat * static_cast<std::uint64_t>(scene_parts) / records_.size();
  };
  std::vector<PartSum> parts;
  for (std::size_t seat = 0; seat < records_.size(); ++seat) {
    const CountRecord& record = *records_[seat];
    all.n += record.n;
    all.bytes += record.bytes;
    all.inserted += record.inserted;
    all.removed += record.removed;
    if (all.n > static_cast<std::uint64_t>(wire::kParticlesMax))
      return cannot_add(seat, "with it there are more particles than a scene has");
    if (record.step_seconds) all.step_seconds = std::max(*record.step_seconds, all.step_seconds.value_or(0));
    if (record.n == 0) continue;  // so it need not say whether there are weights
    if (!record.id_sum) return cannot_add(seat, "field 'id_sum' is missing: each seat says whose particles it counts");
    *all.id_sum += *record.id_sum;
    if (all.n > record.n && record.weights.has_value() != all.weights.has_value())
      return cannot_add(seat, record.weights ? "it has weights, those before it have none" : "it has no weights");
    if (record.epoch != all.epoch || record.hash != all.hash) all.epoch = 0;  // of no cuts in force
    add_parts(record, parts);
    all.strangers += strangers_of(record, first_part(seat), first_part(seat + 1));
    if (record.weights) add_weights(record, all);
  }
  all.parts.clear();
  all.counts.clear();
  for (std::size_t part = 0; part < parts.size(); ++part) {
    if (parts[part].count == 0) continue;
    all.parts.push_back(static_cast<std::int32_t>(part));
    all.counts.push_back(static_cast<std::uint64_t>(parts[part].count));
    if (all.weights) all.weights->loads.push_back(parts[part].load);
  }
  if (const auto due = all.weights ? scale_due(*all.weights, all.n) : std::nullopt)
    for (const auto& record : records_)
      if (record->n > 0 && record->weights->scale != *due) all.weights->scale = record->weights->scale;
  return all;
}

}  // namespace rcb::scene
