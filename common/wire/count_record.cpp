#include "common/wire/count_record.hpp"

#include <cmath>
#include <cstring>
#include <utility>

#include <fmt/format.h>

#include "common/wire/limits.hpp"

namespace rcb::wire {
namespace {

// As it travels, little-endian as all machines that this runs on.
struct Head {
  std::uint64_t says;  // bits of Says; others are 0
  std::uint64_t incarnation;
  std::uint64_t step;
  std::uint64_t epoch;
  std::uint64_t hash;
  std::uint64_t n;
  std::uint64_t inserted;
  std::uint64_t removed;
  std::uint64_t id_sum;
  std::uint64_t drifted;
  double step_seconds;
  std::int64_t scale;
  double least;
  double greatest;
  std::uint64_t weights_as_zero;
};
static_assert(sizeof(Head) == 120);

// What else than the numbers that are always there; where a bit is 0 its number says nothing.
enum Says : std::uint64_t { id_sum_bit = 1, drifted_bit = 2, step_seconds_bit = 4, weights_bit = 8, all_bits = 15 };

// Those that are always there, and as they are in the record.
constexpr std::pair<std::uint64_t Head::*, std::uint64_t CountRecord::*> kAlways[] = {
    {&Head::incarnation, &CountRecord::incarnation},
    {&Head::epoch, &CountRecord::epoch},
    {&Head::hash, &CountRecord::hash},
    {&Head::n, &CountRecord::n},
    {&Head::inserted, &CountRecord::inserted},
    {&Head::removed, &CountRecord::removed}};

struct Row {
  std::uint64_t part;
  std::uint64_t count;
};
struct WeightedRow {
  Row row;
  std::uint64_t load[2];  // the low 64 bits first
};
static_assert(sizeof(Row) == 16 && sizeof(WeightedRow) == 32);

template <typename T>
T value_at(std::span<const std::byte> bytes, std::size_t offset) {
  T value;
  std::memcpy(&value, bytes.data() + offset, sizeof value);
  return value;
}

template <typename T>
void append(std::string& bytes, const T& value) {
  bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
}

Status odd(std::string what) { return {Code::invalid_argument, "count: " + std::move(what)}; }

Status check_range(const char* name, std::uint64_t value, std::int64_t most) {
  if (value <= static_cast<std::uint64_t>(most)) return {};
  return odd(fmt::format("'{}' is {}, at most {} is possible", name, value, most));
}

bool is_amount(double value) { return std::isfinite(value) && value >= 0; }

Status check_head(const Head& head) {
  if ((head.says & ~std::uint64_t{all_bits}) != 0) return odd(fmt::format("'says' has unknown bits: {:x}", head.says));
  struct Range {
    const char* name;
    std::uint64_t value;
    std::int64_t most;
  };
  for (const Range& of : {Range{"step", head.step, kStepMax},
                          {"epoch", head.epoch, kIntegerMax},
                          {"n", head.n, kParticlesMax},
                          {"inserted", head.inserted, kParticlesMax},
                          {"removed", head.removed, kParticlesMax}})
    if (Status status = check_range(of.name, of.value, of.most); !status.ok()) return status;
  if ((head.says & drifted_bit) != 0 && head.drifted > head.n)
    return odd(fmt::format("{} of {} particles drifted", head.drifted, head.n));
  if ((head.says & step_seconds_bit) != 0 && !is_amount(head.step_seconds))
    return odd(fmt::format("a step of {} seconds: it must be finite and >= 0", head.step_seconds));
  if ((head.says & weights_bit) == 0) return {};
  if (head.scale < -kWeightScaleMost || head.scale > kWeightScaleMost)
    return odd(fmt::format("a scale of {}", head.scale));
  if (!is_amount(head.least) || !is_amount(head.greatest) || head.least > head.greatest)
    return odd(fmt::format("weights from {} to {}: they must be finite and >= 0", head.least, head.greatest));
  if (head.weights_as_zero > head.n) return odd(fmt::format("{} weights as zero of {}", head.weights_as_zero, head.n));
  return {};
}

// Reads the rows into a record whose head is read.
Status read_rows(std::span<const std::byte> bytes, CountRecord& record) {
  const std::size_t row_bytes = record.weights ? sizeof(WeightedRow) : sizeof(Row);
  if (bytes.size() % row_bytes != 0)
    return odd(fmt::format("{} bytes after the head are not rows of {} bytes", bytes.size(), row_bytes));
  u128 sum = 0;
  for (std::size_t at = 0; at < bytes.size(); at += row_bytes) {
    const Row row = value_at<Row>(bytes, at);
    const std::int64_t before = record.parts.empty() ? -1 : record.parts.back();
    if (row.part >= static_cast<std::uint64_t>(kPartsMax) || static_cast<std::int64_t>(row.part) <= before)
      return odd(fmt::format("part {} after part {}: parts must be >= 0 and ascend", row.part, before));
    if (row.count == 0) return odd(fmt::format("no particles in part {}, which is listed", row.part));
    sum += row.count;
    record.parts.push_back(static_cast<std::int32_t>(row.part));
    record.counts.push_back(row.count);
    if (!record.weights) continue;
    const auto weighted = value_at<WeightedRow>(bytes, at);
    record.weights->loads.push_back(u128{weighted.load[0]} | u128{weighted.load[1]} << 64U);
  }
  if (sum == record.n) return {};
  return odd(fmt::format("the parts have {} particles together, and n is {}", static_cast<double>(sum), record.n));
}

}  // namespace

std::uint64_t count_record_bytes_most(std::uint64_t parts) { return sizeof(Head) + parts * sizeof(WeightedRow); }

std::string encode(const CountRecord& record) {
  Head head{};
  const auto say = [&head](Says bit, const auto& value, auto& into) {
    if (!value) return;
    head.says |= bit;
    into = *value;
  };
  for (const auto& [there, here] : kAlways) head.*there = record.*here;
  head.step = static_cast<std::uint64_t>(record.step);
  say(id_sum_bit, record.id_sum, head.id_sum);
  say(drifted_bit, record.drifted, head.drifted);
  say(step_seconds_bit, record.step_seconds, head.step_seconds);
  if (const auto& weights = record.weights) {
    head.says |= weights_bit;
    head.scale = weights->scale;
    head.least = weights->least;
    head.greatest = weights->greatest;
    head.weights_as_zero = weights->as_zero;
  }
  std::string bytes;
  bytes.reserve(count_record_bytes_most(record.parts.size()));
  append(bytes, head);
  for (std::size_t k = 0; k < record.parts.size(); ++k) {
    append(bytes, Row{static_cast<std::uint64_t>(record.parts[k]), record.counts[k]});
    if (record.weights) append(bytes, record.weights->loads[k]);
  }
  return bytes;
}

Result<CountRecord> decode_count_record(std::span<const std::byte> bytes) {
  if (bytes.size() < sizeof(Head))
    return odd(fmt::format("a record of {} bytes, of which the head has {}", bytes.size(), sizeof(Head)));
  const auto head = value_at<Head>(bytes, 0);
  if (Status status = check_head(head); !status.ok()) return status;
  CountRecord record;
  for (const auto& [there, here] : kAlways) record.*here = head.*there;
  record.step = static_cast<std::int64_t>(head.step);
  if ((head.says & id_sum_bit) != 0) record.id_sum = head.id_sum;
  if ((head.says & drifted_bit) != 0) record.drifted = head.drifted;
  if ((head.says & step_seconds_bit) != 0) record.step_seconds = head.step_seconds;
  if ((head.says & weights_bit) != 0)
    record.weights = WeightCount{static_cast<int>(head.scale), head.least, head.greatest, head.weights_as_zero, {}};
  if (Status status = read_rows(bytes.subspan(sizeof(Head)), record); !status.ok()) return status;
  return record;
}

}  // namespace rcb::wire
