#include "common/cuts/count.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include "common/base/index.hpp"
#include "common/cuts/calls.hpp"
#include "common/cuts/id_sum.hpp"
#include "common/cuts/kernels.hpp"
#include "common/cuts/owner_pass.hpp"
#include "common/particles/block_ranges.hpp"
#include "common/particles/value_fault.hpp"

namespace rcb::cuts {
namespace {

std::uint64_t differing(const std::int32_t* a, const std::int32_t* b, std::size_t count) {
  std::int32_t found = 0;
  for (std::size_t i = 0; i < count; ++i) found += a[i] != b[i] ? 1 : 0;
  return static_cast<std::uint64_t>(found);
}

// Counts a share of the rows.
class CountPass {
 public:
  CountPass(const OwnerTables& tables, const Positions& positions, const CountOptions& options,
            std::span<std::int32_t> part)
      : positions_(positions),
        options_(options),
        part_(part),
        pass_(tables, positions, options.ids, options.last_part),
        parts_(at(tables.tree.parts)),
        counts_(parts_ * (kInTurn + 1)),
        loads_(options.weights.empty() ? 0 : parts_),
        too_great_(std::ldexp(1.0, 127 - options.scale)) {}

  // At most Batch::kMost rows.
  Status add(std::size_t first, std::size_t count);
  void add_to(Count& sum) const;

 private:
  u128 load_of(std::size_t first, std::size_t count);
  void scale(std::size_t first, std::size_t count);
  Status add_ids(std::size_t first, std::size_t count);
  void add_parts(std::size_t first, std::size_t count, bool weighted);
  Status fault(std::size_t first, std::size_t count) const;

  // Rows that differ from their neighbours are counted in several tables in turn: else a sum of few parts would wait
  // for the one before.
  static constexpr std::size_t kInTurn = 4;

  const Positions& positions_;
  const CountOptions& options_;
  std::span<std::int32_t> part_;
  OwnerPass pass_;
  std::size_t parts_;
  std::vector<std::uint64_t> counts_;
  std::vector<u128> loads_;
  double too_great_;  // from this weight on a smaller scale is due
  Count sums_;
  double least_ = std::numeric_limits<double>::infinity();  // weight
  double most_ = 0;
  ScaledWeights scaled_;
  std::array<std::int32_t, Batch::kMost> before_;
};

Status CountPass::add(std::size_t first, std::size_t count) {
  std::int32_t* const part = &part_[first];
  const bool hinted = !options_.last_part.empty();
  if (hinted) std::copy_n(&options_.last_part[first], count, before_.data());
  if (!pass_.read_rows(first, count, part))
    if (Status status = pass_.read(first, count, part); !status) return fault(first, count);
  if (hinted) sums_.drifted += differing(part, before_.data(), count);
  if (options_.id_key && !options_.ids.empty())
    if (Status status = add_ids(first, count); !status) return status;
  bool weighted = !loads_.empty();
  if (weighted) {
    const particles::Range weights = particles::range_of(options_.weights.subspan(first, count));
    if (!(weights.lo >= 0 && std::isfinite(weights.hi))) return fault(first, count);
    least_ = std::min(least_, weights.lo);
    most_ = std::max(most_, weights.hi);
    weighted = weights.hi < too_great_;
  }
  add_parts(first, count, weighted);
  return {};
}

void CountPass::add_parts(std::size_t first, std::size_t count, bool weighted) {
  const std::size_t run = pass_.uniform() >= 0 ? count : OwnerPass::kWord;
  for (std::size_t from = first; from < first + count; from += run) {
    const std::size_t size = std::min(run, first + count - from);
    const std::int32_t* const p = &part_[from];
    if (pass_.uniform() >= 0 || all_equal(p, size)) {
      counts_[at(p[0])] += size;
      if (weighted) loads_[at(p[0])] += load_of(from, size);
      continue;
    }
    std::array<std::uint64_t*, kInTurn> table;
    for (std::size_t t = 0; t < kInTurn; ++t) table[t] = &counts_[(1 + t) * parts_];
    for (std::size_t i = 0; i < size; ++i) ++table[i % kInTurn][p[i]];
    if (!weighted) continue;
    scale(from, size);
    for (std::size_t i = 0; i < size; ++i) loads_[at(p[i])] += scaled_[i];
  }
}

// Of rows of one part.
u128 CountPass::load_of(std::size_t first, std::size_t count) {
  u128 load = 0;
  std::size_t done = 0;
  if (options_.scale >= QuickSum::kScaleLeast) {
    const std::size_t most = count - count % QuickSum::kLanesMost;
    const QuickSum quick = kernels().sum(&options_.weights[first], most, options_.scale);
    if (!quick.small) {
      load = quick.value(options_.scale);
      done = most;
    }
  }
  if (done == count) return load;
  scale(first + done, count - done);
  return load + scaled_.sum(count - done);
}

void CountPass::scale(std::size_t first, std::size_t count) {
  kernels().scale(&options_.weights[first], count, options_.scale, scaled_);
  sums_.weights_as_zero += scaled_.as_zero;
}

Status CountPass::add_ids(std::size_t first, std::size_t count) {
  const IdSums ids = sum_ids(options_.ids.subspan(first, count), *options_.id_key);
  sums_.id_sum += ids.any_order;
  return ids.negative ? fault(first, count) : Status();
}

// What is wrong with the first of these rows that isn't right.
Status CountPass::fault(std::size_t first, std::size_t count) const {
  for (std::size_t i = first; i < first + count; ++i) {
    const particles::Id id = options_.ids.empty() ? static_cast<particles::Id>(i) : options_.ids[i];
    const double weight = options_.weights.empty() ? 1 : options_.weights[i];
    if (const auto found = particles::fault_of(positions_.point(i), positions_.dims, weight, id))
      return {found->code,
              fmt::format("particle {}{}: {}", id, options_.ids.empty() ? " (index, from 0)" : "", found->text),
              found->rule};
  }
  return {};
}

void CountPass::add_to(Count& sum) const {
  for (std::size_t i = 0; i < counts_.size(); ++i) sum.counts[i % parts_] += counts_[i];
  for (std::size_t p = 0; p < loads_.size(); ++p) sum.loads[p] += loads_[p];
  sum.weights_as_zero += sums_.weights_as_zero;
  sum.id_sum += sums_.id_sum;
  sum.drifted += sums_.drifted;
  if (loads_.empty()) return;
  sum.least = std::min(sum.least, least_ + 0.0);
  sum.greatest = std::max(sum.greatest, most_ + 0.0);
}

}  // namespace

Result<Count> count(const Cuts& cuts, const Positions& positions, const CountOptions& options,
                    std::span<std::int32_t> part) {
  if (Status status = check_call(cuts.tree(), positions, options); !status) return status;
  if (Status status = check_room(positions, part); !status) return status;
  if (!options.weights.empty() && options.weights.size() != positions.count)
    return bad_call(fmt::format("{} weights for {} positions", options.weights.size(), positions.count));
  return within_memory([&]() -> Result<Count> {
    Count sum;
    sum.n = positions.count;
    sum.counts.resize(at(cuts.parts()));
    if (!options.weights.empty()) {
      sum.loads.resize(at(cuts.parts()));
      sum.least = std::numeric_limits<double>::infinity();
    }
    const std::size_t shares = shares_of(positions.count, options.threads);
    std::vector<std::unique_ptr<CountPass>> passes(shares);
    const Status status = share_rows(positions.count, shares, [&](std::size_t k, std::size_t begin, std::size_t end) {
      passes[k] = std::make_unique<CountPass>(cuts.tables(), positions, options, part);
      for (std::size_t first = begin; first < end; first += Batch::kMost)
        if (Status bad = passes[k]->add(first, std::min(Batch::kMost, end - first)); !bad) return bad;
      return Status();
    });
    if (!status) return status;
    for (const auto& pass : passes) pass->add_to(sum);
    return sum;
  });
}

}  // namespace rcb::cuts
