#include "common/cuts/count.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include "common/base/cpu.hpp"
#include "common/base/index.hpp"
#include "common/cuts/calls.hpp"
#include "common/cuts/id_sum.hpp"
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

// Sums weights of one part three times as fast, where each is 0 or so large that its last bit counts in the scale (that
// is, within 2^55 of the greatest for a million particles). Each is split into three doubles of so few bits that 512 of
// them are added without rounding: ExtractVector of Rump, Ogita, Oishi 2008, doi:10.1137/050645671.
struct QuickSum {
  double upper, middle, lower;  // of the weights; NaN if one of them is not finite
  double least, most;
  bool small;  // there is one that is rounded in the scale, and the sum is of no use

  static constexpr int kMiddle = 35, kUpper = 75;  // binades above the last place of the scale where the splits are
  static constexpr int kScaleLeast = -890;         // so that no sum overflows

  bool usable(int scale) const {
    return !small && least >= 0 && std::isfinite(upper + middle + lower) && most < std::ldexp(1.0, 126 - scale);
  }
  u128 value(int scale) const {
    const auto whole = [scale](double sum, int place) {
      return static_cast<u128>(static_cast<std::int64_t>(std::ldexp(sum, scale - place)))
             << static_cast<unsigned>(place);
    };
    return whole(upper, kUpper) + whole(middle, kMiddle) + whole(lower, 0);  // mod 2^128: some are negative
  }
};

struct TwoLanes {
  using Lanes = double __attribute__((vector_size(16)));
};
struct FourLanes {
  using Lanes = double __attribute__((vector_size(32)));
};
constexpr std::size_t kLanesMost = 4;

// count: a multiple of the lanes, at most Batch::kMost.
template <typename Width>
[[gnu::always_inline]] inline void sum_quickly(const double* weight, std::size_t count, int scale, QuickSum& to) {
  using Lanes = typename Width::Lanes;
  constexpr std::size_t kLanes = sizeof(Lanes) / sizeof(double);
  const double at_upper = std::ldexp(1.5, QuickSum::kUpper + 52 - scale);
  const double at_middle = std::ldexp(1.5, QuickSum::kMiddle + 52 - scale);
  const Lanes limit = Lanes{} + std::ldexp(1.0, 52 - scale);
  const Lanes zero{};
  Lanes upper{}, middle{}, lower{}, most{};
  Lanes least = zero + std::numeric_limits<double>::infinity();
  auto small = limit > limit;
  for (std::size_t i = 0; i < count; i += kLanes) {
    Lanes own;
    std::memcpy(&own, weight + i, sizeof own);
    least = own < least ? own : least;
    most = own > most ? own : most;
    small |= (own < limit) & (own > zero);
    const Lanes high = (own + at_upper) - at_upper;
    const Lanes rest = own - high;
    const Lanes mid = (rest + at_middle) - at_middle;
    upper += high;
    middle += mid;
    lower += rest - mid;
  }
  to = {0, 0, 0, least[0], most[0], false};
  for (std::size_t k = 0; k < kLanes; ++k) {
    to.upper += upper[k];
    to.middle += middle[k];
    to.lower += lower[k];
    to.least = std::min(to.least, least[k]);
    to.most = std::max(to.most, most[k]);
    to.small = to.small || small[k] != 0;
  }
}

#if defined(__x86_64__)
[[gnu::target("avx2")]] void sum_quickly_avx2(const double* weight, std::size_t count, int scale, QuickSum& to) {
  sum_quickly<FourLanes>(weight, count, scale, to);
}
#endif

QuickSum quick_sum(const double* weight, std::size_t count, int scale) {
  QuickSum sum;
#if defined(__x86_64__)
  if (has_avx2()) return sum_quickly_avx2(weight, count, scale, sum), sum;
#endif
  sum_quickly<TwoLanes>(weight, count, scale, sum);
  return sum;
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
  std::size_t done = count - count % kLanesMost;
  u128 load = 0;
  const QuickSum quick = options_.scale < QuickSum::kScaleLeast
                             ? QuickSum{.small = true}
                             : quick_sum(&options_.weights[first], done, options_.scale);
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
  scale_weights(&options_.weights[first], count, options_.scale, scaled_);
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
