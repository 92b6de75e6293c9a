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
#include "common/wire/message.hpp"
#include "server/scene/ledger.hpp"
#include "server/scene/tally.hpp"

namespace rcb::testing {

struct CountRequest {
  wire::Json json;
  std::vector<wire::Array> arrays;
};

template <typename T>
wire::Array array_of(const char* name, const char* dtype, const std::vector<T>& values, std::uint64_t columns = 1) {
  wire::Array array{name, dtype, {values.size() / columns}, {}};
  if (columns > 1) array.shape.push_back(columns);
  array.bytes.assign(std::as_bytes(std::span(values)));
  return array;
}

// Of a weight that needs a smaller scale: any bits.
inline u128 scaled_weight(double weight, int scale) {
  int above = 0;
  std::frexp(weight, &above);
  return above + scale > 127 ? ~u128{0} : ExactScale(scale)(weight);
}

// Counts the rows [first, last), which have these parts; weights in this scale. What identifies the step is left out.
inline CountRequest count_rows(const particles::ParticleView& particles, std::span<const std::int32_t> part,
                               std::size_t first, std::size_t last, int scale) {
  std::map<std::int32_t, std::pair<std::uint64_t, u128>> sums;
  std::uint64_t id_sum = 0;
  std::uint64_t as_zero = 0;
  double least = std::numeric_limits<double>::infinity();
  double greatest = 0;
  for (std::size_t i = first; i < last; ++i) {
    auto& [count, load] = sums[part[i]];
    ++count;
    id_sum += mix64(static_cast<std::uint64_t>(particles.id_of(i)));
    if (particles.weight == nullptr) continue;
    const double weight = particles.weight[i];
    const u128 scaled = scaled_weight(weight, scale);
    load += scaled;
    as_zero += scaled == 0 && weight > 0 ? 1 : 0;
    least = std::min(least, weight);
    greatest = std::max(greatest, weight);
  }
  std::vector<std::int32_t> parts;
  std::vector<std::uint64_t> counts;
  std::vector<std::uint64_t> halves;
  for (const auto& [p, sum] : sums) {
    parts.push_back(p);
    counts.push_back(sum.first);
    halves.push_back(static_cast<std::uint64_t>(sum.second));
    halves.push_back(static_cast<std::uint64_t>(sum.second >> 64U));
  }
  CountRequest request{{{"n", last - first}, {"id_sum", wire::hex64(id_sum)}}, {}};
  request.arrays.push_back(array_of("part", "<i4", parts));
  request.arrays.push_back(array_of("count", "<u8", counts));
  if (particles.weight == nullptr || first == last) return request;
  request.json.update({{"scale", scale}, {"least", least}, {"greatest", greatest}, {"weights_as_zero", as_zero}});
  request.arrays.push_back(array_of("load", "<u8", halves, 2));
  return request;
}

// The scale that these weights need, as the ranks find it.
inline std::optional<int> scale_needed(const particles::ParticleView& particles) {
  const auto bits = partition::weight_order_bits(particles);
  const auto greatest = partition::greatest_weight(bits);
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
  if (const auto* again = std::get_if<scene::CountVerdict::Repeated>(&verdict.is))
    return fmt::format("repeated {}", again->number);
  return fmt::format("committed after {}",
                     std::get<scene::CountVerdict::Committed>(verdict.is).previous_step.value_or(-1));
}

// Counts a step, of which each seat brings its share.
inline std::string ask(scene::Ledger& ledger, const std::vector<CountRequest>& seats) {
  scene::Tally tally(0, seats.size());
  Result<scene::CountRecord> record = Status(Code::internal, "no seats");
  for (std::size_t seat = 0; seat < seats.size(); ++seat) {
    record = scene::read_count(seats[seat].json, seats[seat].arrays);
    if (!record.ok()) return fmt::format("malformed {}", code_name(record.status().code()));
    tally.put(seat, *record);
  }
  if (seats.size() > 1) record = tally.sum(ledger.now().options.parts);
  if (!record.ok()) return fmt::format("malformed {}", code_name(record.status().code()));
  return in_words(ledger.count(*record));
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
