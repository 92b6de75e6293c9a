#include "common/cuts/count.hpp"

#include <algorithm>
#include <bit>
#include <limits>
#include <memory>
#include <optional>

#include <fmt/format.h>

#include "common/base/cpu.hpp"
#include "common/base/index.hpp"
#include "common/base/random.hpp"
#include "common/cuts/calls.hpp"
#include "common/cuts/owner_pass.hpp"
#include "common/particles/value_fault.hpp"

namespace rcb::cuts {
namespace {

constexpr std::int64_t kGreatestFinite = std::bit_cast<std::int64_t>(std::numeric_limits<double>::max());

// Of at most Batch::kMost weights: each as an integer in the scale, and the range of all. The bits of doubles that are
// not negative compare as the doubles do; those of negative ones are below 0, of infinity and NaN above all finite
// ones.
struct ScaledWeights {
  using Halves = std::array<std::uint64_t, Batch::kMost>;
  alignas(64) Halves low;
  alignas(64) Halves high;
  std::int64_t least;
  std::int64_t most;
  std::uint64_t as_zero;

  u128 operator[](std::size_t i) const { return (u128{high[i]} << 64U) + low[i]; }
  u128 sum(std::size_t first, std::size_t count) const {
    std::uint64_t quarter = 0, half = 0, rest = 0;  // a load is below 2^127, so `rest` is whole
    for (std::size_t i = first; i < first + count; ++i) {
      quarter += low[i] & 0xFFFFFFFFU;
      half += low[i] >> 32U;
      rest += high[i];
    }
    return (u128{rest} << 64U) + (u128{half} << 32U) + quarter;
  }
};

// As ExactScale does, by steps that compilers make vectors of.
[[gnu::always_inline]] inline void scale_all(const double* weight, std::size_t count, std::int64_t scale,
                                             ScaledWeights& to) {
  std::int64_t least = std::numeric_limits<std::int64_t>::max();
  std::int64_t most = std::numeric_limits<std::int64_t>::min();
  std::uint64_t as_zero = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const auto bits = std::bit_cast<std::int64_t>(weight[i]);
    least = std::min(least, bits);
    most = std::max(most, bits);
    const auto exponent = static_cast<std::int64_t>((static_cast<std::uint64_t>(bits) >> 52U) & 0x7FFU);
    const std::uint64_t significand = (static_cast<std::uint64_t>(bits) & 0xFFFFFFFFFFFFFU) |
                                      static_cast<std::uint64_t>(std::min<std::int64_t>(exponent, 1)) << 52U;
    const std::int64_t shift = std::max<std::int64_t>(exponent, 1) - 1075 + scale;
    const std::uint64_t whole = significand >> std::clamp<std::int64_t>(-shift, 0, 63);
    const auto up = static_cast<std::uint64_t>(std::max<std::int64_t>(shift, 0));
    const std::uint64_t beyond = 0 - (up >> 6U);  // all ones from a shift of 64 on
    const std::uint64_t shifted = whole << (up & 63U);
    const std::uint64_t low = shifted & ~beyond;
    const std::uint64_t high = (shifted & beyond) | (whole >> 1U >> (63U - (up & 63U)) & ~beyond);
    as_zero += (significand != 0 ? 1U : 0U) & (whole == 0 ? 1U : 0U);
    to.low[i] = low;
    to.high[i] = high;
  }
  to.least = least;
  to.most = most;
  to.as_zero = as_zero;
}

#if defined(__x86_64__)
[[gnu::target("avx2")]] void scale_all_avx2(const double* weight, std::size_t count, std::int64_t scale,
                                            ScaledWeights& to) {
  scale_all(weight, count, scale, to);
}
#endif

void scale_weights(const double* weight, std::size_t count, std::int64_t scale, ScaledWeights& to) {
#if defined(__x86_64__)
  if (has_avx2()) return scale_all_avx2(weight, count, scale, to);
#endif
  scale_all(weight, count, scale, to);
}

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
  Status add_weights(std::size_t first, std::size_t count);
  Status add_ids(std::size_t first, std::size_t count);
  void add_parts(const std::int32_t* part, std::size_t count);
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
  std::int64_t least_ = std::numeric_limits<std::int64_t>::max();  // bits of weights
  std::int64_t most_ = 0;
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
  if (!loads_.empty())
    if (Status status = add_weights(first, count); !status) return status;
  if (options_.sum_ids && !options_.ids.empty())
    if (Status status = add_ids(first, count); !status) return status;
  add_parts(part, count);
  return {};
}

void CountPass::add_parts(const std::int32_t* part, std::size_t count) {
  const std::size_t run = pass_.uniform() >= 0 ? count : OwnerPass::kWord;
  for (std::size_t from = 0; from < count; from += run) {
    const std::size_t size = std::min(run, count - from);
    const std::int32_t* const p = part + from;
    if (pass_.uniform() >= 0 || all_equal(p, size)) {
      counts_[at(p[0])] += size;
      if (!loads_.empty()) loads_[at(p[0])] += scaled_.sum(from, size);
      continue;
    }
    std::array<std::uint64_t*, kInTurn> table;
    for (std::size_t t = 0; t < kInTurn; ++t) table[t] = &counts_[(1 + t) * parts_];
    for (std::size_t i = 0; i < size; ++i) ++table[i % kInTurn][p[i]];
    for (std::size_t i = 0; i < size && !loads_.empty(); ++i) loads_[at(p[i])] += scaled_[from + i];
  }
}

Status CountPass::add_weights(std::size_t first, std::size_t count) {
  scale_weights(&options_.weights[first], count, options_.scale, scaled_);
  sums_.weights_as_zero += scaled_.as_zero;
  if (scaled_.least < 0 || scaled_.most > kGreatestFinite)  // -0.0 is none
    if (Status status = fault(first, count); !status) return status;
  least_ = std::min(least_, std::max<std::int64_t>(scaled_.least, 0));
  most_ = std::max(most_, scaled_.most);
  return {};
}

Status CountPass::add_ids(std::size_t first, std::size_t count) {
  particles::Id sign = 0;
  for (const particles::Id id : options_.ids.subspan(first, count)) {
    sums_.id_sum += mix64(static_cast<std::uint64_t>(id));
    sign |= id;
  }
  return sign < 0 ? fault(first, count) : Status();
}

// What is wrong with the first of these rows that isn't right.
Status CountPass::fault(std::size_t first, std::size_t count) const {
  for (std::size_t i = first; i < first + count; ++i) {
    const particles::Id id = options_.ids.empty() ? static_cast<particles::Id>(i) : options_.ids[i];
    const double weight = options_.weights.empty() ? 1 : options_.weights[i];
    if (const auto found = particles::fault_of(positions_.point(i), positions_.dims, weight, id))
      return {found->code, fmt::format("particle {}: {}", id, found->text), particles::kGoodValues};
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
  sum.least = std::min(sum.least, std::bit_cast<double>(least_));
  sum.greatest = std::max(sum.greatest, std::bit_cast<double>(most_));
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
