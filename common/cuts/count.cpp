#include "common/cuts/count.hpp"

#include <algorithm>
#include <bit>
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
#include "common/particles/value_fault.hpp"

namespace rcb::cuts {
namespace {

constexpr std::int64_t kGreatestFinite = std::bit_cast<std::int64_t>(std::numeric_limits<double>::max());

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
        loads_(options.weights.empty() ? 0 : parts_) {}

  // At most Batch::kMost rows.
  Status add(std::size_t first, std::size_t count);
  void add_to(Count& sum) const;

 private:
  u128 load_of(std::size_t first, std::size_t count);
  void scale(std::size_t first, std::size_t count);
  Status add_ids(std::size_t first, std::size_t count);
  void add_parts(std::size_t first, std::size_t count);
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
  Count sums_;
  double least_ = std::numeric_limits<double>::infinity();  // weight
  double most_ = 0;
  bool wrong_weight_ = false;
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
  add_parts(first, count);
  return std::exchange(wrong_weight_, false) ? fault(first, count) : Status();
}

void CountPass::add_parts(std::size_t first, std::size_t count) {
  const std::size_t run = pass_.uniform() >= 0 ? count : OwnerPass::kWord;
  for (std::size_t from = first; from < first + count; from += run) {
    const std::size_t size = std::min(run, first + count - from);
    const std::int32_t* const p = &part_[from];
    if (pass_.uniform() >= 0 || all_equal(p, size)) {
      counts_[at(p[0])] += size;
      if (!loads_.empty()) loads_[at(p[0])] += load_of(from, size);
      continue;
    }
    std::array<std::uint64_t*, kInTurn> table;
    for (std::size_t t = 0; t < kInTurn; ++t) table[t] = &counts_[(1 + t) * parts_];
    for (std::size_t i = 0; i < size; ++i) ++table[i % kInTurn][p[i]];
    if (loads_.empty()) continue;
    scale(from, size);
    for (std::size_t i = 0; i < size; ++i) loads_[at(p[i])] += scaled_[i];
  }
}

u128 CountPass::load_of(std::size_t first, std::size_t count) {
  std::size_t done = count - count % QuickSum::kLanesMost;
  u128 load = 0;
  const QuickSum quick = options_.scale < QuickSum::kScaleLeast
                             ? QuickSum{.small = true}
                             : kernels().sum(&options_.weights[first], done, options_.scale);
  if (quick.usable(options_.scale)) {
    load = quick.value(options_.scale);
    least_ = std::min(least_, quick.least);
    most_ = std::max(most_, quick.most);
  } else {
    done = 0;
  }
  if (done == count) return load;
  scale(first + done, count - done);
  return load + scaled_.sum(0, count - done);
}

void CountPass::scale(std::size_t first, std::size_t count) {
  kernels().scale(&options_.weights[first], count, options_.scale, scaled_);
  sums_.weights_as_zero += scaled_.as_zero;
  const std::int64_t least = std::max<std::int64_t>(scaled_.least, 0);  // -0.0 is 0
  const std::int64_t most = std::max<std::int64_t>(scaled_.most, 0);
  wrong_weight_ = wrong_weight_ || scaled_.least < 0 || scaled_.most > kGreatestFinite;
  least_ = std::min(least_, std::bit_cast<double>(least));
  most_ = std::max(most_, std::bit_cast<double>(most));
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
