// Counts of particles as a solver's processes send them, and what a ledger makes of them.
#pragma once

#include <cmath>
#include <cstdint>
#include <future>
#include <limits>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "common/base/random.hpp"
#include "common/base/wide.hpp"
#include "common/partition/balance/load.hpp"
#include "common/wire/count_record.hpp"
#include "server/scene/ledger.hpp"
#include "server/scene/tally.hpp"

namespace rcb::testing {

// Of a weight that needs a smaller scale: any bits.
inline u128 scaled_weight(double weight, int scale) {
  int above = 0;
  std::frexp(weight, &above);
  return above + scale > 127 ? ~u128{0} : ExactScale(scale)(weight);
}

// Counts the rows [first, last), which have these parts; weights in this scale. What identifies the step is left out.
inline scene::CountRecord count_rows(const particles::ParticleView& particles, std::span<const std::int32_t> part,
                                     std::size_t first, std::size_t last, int scale) {
  scene::CountRecord record;
  record.n = last - first;
  record.id_sum = 0;
  if (particles.weight != nullptr && first != last)
    record.weights = scene::WeightCount{scale, std::numeric_limits<double>::infinity(), 0, 0, {}};
  std::map<std::int32_t, std::pair<std::uint64_t, u128>> sums;
  for (std::size_t i = first; i < last; ++i) {
    auto& [count, load] = sums[part[i]];
    ++count;
    *record.id_sum += mix64(static_cast<std::uint64_t>(particles.id_of(i)));
    if (!record.weights) continue;
    const double weight = particles.weight[i];
    const u128 scaled = scaled_weight(weight, scale);
    load += scaled;
    record.weights->as_zero += scaled == 0 && weight > 0 ? 1 : 0;
    record.weights->least = std::min(record.weights->least, weight);
    record.weights->greatest = std::max(record.weights->greatest, weight);
  }
  for (const auto& [p, sum] : sums) {
    record.parts.push_back(p);
    record.counts.push_back(sum.first);
    if (record.weights) record.weights->loads.push_back(sum.second);
  }
  return record;
}

// As it arrives.
inline Result<scene::CountRecord> received(scene::CountRecord record) {
  const std::string bytes = wire::encode(record);
  auto decoded = wire::decode_count_record(std::as_bytes(std::span(bytes)));
  if (!decoded.ok()) return decoded.status();
  static_cast<wire::CountRecord&>(record) = std::move(*decoded);
  return record;
}

// The scale that these weights need, as the ranks find it.
inline std::optional<int> scale_needed(const particles::ParticleView& particles) {
  const auto greatest = partition::greatest_weight(partition::weight_range(particles));
  if (!greatest) return std::nullopt;
  return ExactScale(*greatest, particles.count).exponent();
}

inline std::string in_words(const scene::CountVerdict& verdict) {
  if (const auto* status = std::get_if<Status>(&verdict.is))
    return fmt::format("refused {}", code_name(status->code()));
  if (const auto* send = std::get_if<scene::CountVerdict::Send>(&verdict.is)) return "send: " + send->why;
  if (std::holds_alternative<scene::CountVerdict::OtherCuts>(verdict.is)) return "other cuts";
  if (const auto* other = std::get_if<scene::CountVerdict::OtherScale>(&verdict.is))
    return fmt::format("other scale {}", other->exponent);
  return fmt::format("committed after {}",
                     std::get<scene::CountVerdict::Committed>(verdict.is).previous_step.value_or(-1));
}

// Counts a step, of which each seat brings its share.
inline std::string ask(scene::Ledger& ledger, const std::vector<scene::CountRecord>& seats) {
  scene::Tally tally(seats.size());
  for (std::size_t seat = 0; seat < seats.size(); ++seat) {
    const auto record = received(seats[seat]);
    if (!record.ok()) return fmt::format("malformed {}", code_name(record.status().code()));
    if (const Status fits = ledger.check_seat(*record); fits.code() == Code::stale_step)
      return ledger.was_in_last(record->session, record->step) ? "repeated" : "refused stale_step";
    tally.put(seat, *record);
  }
  auto all = tally.sum(ledger.now().options.parts);
  if (!all.ok()) return fmt::format("malformed {}", code_name(all.status().code()));
  return in_words(ledger.count(*all));
}

// All reports from `first` on, of the memory or the journal.
inline std::vector<wire::Json> reports(const scene::Ledger& ledger, std::uint64_t first) {
  const scene::History& history = ledger.history();
  if (history.in_memory(first)) return history.newest(first, history.total()).reports;
  std::promise<void> done;
  scene::FoundReports found;
  const Status begun = history.reading(first, history.total(), ledger.journal())(
      [&found](scene::FoundReports all) { found = std::move(all); }, [&done] { done.set_value(); });
  EXPECT_TRUE(begun.ok());
  if (begun.ok()) done.get_future().wait();
  return found.reports;
}

}  // namespace rcb::testing
