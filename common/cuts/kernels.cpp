#include "common/cuts/kernels.hpp"

#include <algorithm>
#include <bit>
#include <cstring>

#include "common/base/random.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "common/cuts/kernels.cpp"
#include "common/base/highway.hpp"
// Behind Highway, which it needs.
#include "common/base/vectors-inl.hpp"

HWY_BEFORE_NAMESPACE();
namespace rcb::cuts::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using rcb::HWY_NAMESPACE::any_lane, rcb::HWY_NAMESPACE::bits_of, rcb::HWY_NAMESPACE::look_up;

template <typename D>
constexpr std::uint64_t kAll = (std::uint64_t{1} << hn::MaxLanes(D())) - 1;  // a bit for each lane

// All cuts of the three levels are compared with each row, which is cheaper than looking up the one cut of each level
// that matters.
std::size_t descend(const TopCuts& top, const double* x, std::size_t count, std::int32_t* out, std::uint8_t* tied) {
  const hn::ScalableTag<double> d;
  using D = decltype(d);
  const hn::Rebind<std::uint32_t, D> narrow;
  const hn::RebindToUnsigned<D> wide;
  constexpr std::size_t kLanes = hn::MaxLanes(d);
  if constexpr (kLanes < 4) return 0;
  const std::size_t end = count / kLanes * kLanes;
  hn::Vec<D> label[8];
  for (std::size_t k = 0; k < top.label.size(); ++k)
    label[k] = hn::BitCast(d, hn::Set(wide, static_cast<std::uint64_t>(top.label[k])));
  for (std::size_t i = 0; i < end; i += kLanes) {
    hn::Vec<D> right[7];
    auto on = hn::Zero(d);
    for (std::size_t k = 0; k < top.value.size(); ++k) {
      const auto own = hn::LoadU(d, x + top.at[k] + i);
      const auto value = hn::Set(d, top.value[k]);
      right[k] = hn::VecFromMask(d, hn::Gt(own, value));
      on = hn::Or(on, hn::VecFromMask(d, hn::Eq(own, value)));  // may be off its path
    }
    hn::Vec<D> below[4];
    for (std::size_t k = 0; k < 4; ++k) below[k] = hn::IfVecThenElse(right[3 + k], label[2 * k + 1], label[2 * k]);
    const auto found = hn::IfVecThenElse(right[0], hn::IfVecThenElse(right[2], below[3], below[2]),
                                         hn::IfVecThenElse(right[1], below[1], below[0]));
    hn::StoreU(hn::TruncateTo(narrow, hn::BitCast(wide, found)), narrow, reinterpret_cast<std::uint32_t*>(out + i));
    if (hn::AllFalse(d, hn::MaskFromVec(on))) continue;
    for (std::size_t k = 0; k < kLanes; ++k)
      for (std::size_t c = 0; c < top.value.size(); ++c)
        tied[i + k] |= static_cast<std::uint8_t>(x[static_cast<std::size_t>(top.at[c]) + i + k] == top.value[c]);
  }
  return end;
}

// The first rows, by bounds that are looked up in registers. Returns how many.
template <std::size_t kParts, typename D>
std::size_t outside_few(D d, std::span<const double> x, const std::int32_t* part, const AxisBounds& bounds,
                        std::uint64_t& outside) {
  const hn::RebindToSigned<D> wide;
  const hn::Rebind<std::int32_t, D> narrow;
  std::size_t i = 0;
  for (; i + hn::Lanes(d) <= x.size(); i += hn::Lanes(d)) {
    const auto p = hn::PromoteTo(wide, hn::Sub(hn::LoadU(narrow, part + i), hn::Set(narrow, bounds.first)));
    const auto own = hn::LoadU(d, x.data() + i);
    const auto in =
        hn::And(hn::Gt(own, look_up<kParts>(d, bounds.lo, p)), hn::Lt(own, look_up<kParts>(d, bounds.hi, p)));
    outside |= (bits_of(d, in) ^ kAll<D>) << i;
  }
  return i;
}

std::uint64_t outside_own(std::span<const double> x, const std::int32_t* part, const AxisBounds& bounds) {
  const hn::ScalableTag<double> d;
  std::uint64_t outside = 0;
  std::size_t i = 0;
  if constexpr (hn::MaxLanes(d) >= 4) {
    if (bounds.parts <= 4)
      i = outside_few<4>(d, x, part, bounds, outside);
    else if (bounds.parts <= 8)
      i = outside_few<8>(d, x, part, bounds, outside);
  }
  for (; i < x.size(); ++i) {
    const auto p = static_cast<std::size_t>(part[i] - bounds.first);
    outside |= static_cast<std::uint64_t>(!((x[i] > bounds.lo[p]) & (x[i] < bounds.hi[p]))) << i;
  }
  return outside;
}

std::uint64_t outside(const particles::Axes& x, std::size_t count, const geometry::Box& box) {
  const hn::ScalableTag<double> d;
  const auto within = [&](std::size_t a, std::size_t i) HWY_ATTR {
    const auto own = hn::LoadU(d, x[a] + i);
    return hn::And(hn::Gt(own, hn::Set(d, box.lo[a])), hn::Lt(own, hn::Set(d, box.hi[a])));
  };
  std::uint64_t outside = 0;
  std::size_t i = 0;
  for (; i + hn::Lanes(d) <= count; i += hn::Lanes(d)) {
    const auto in = hn::And(within(0, i), hn::And(within(1, i), within(2, i)));
    outside |= (bits_of(d, in) ^ kAll<decltype(d)>) << i;
  }
  for (; i < count; ++i) {
    bool in = true;
    for (std::size_t a = 0; a < x.size(); ++a) in = in & (x[a][i] > box.lo[a]) & (x[a][i] < box.hi[a]);
    outside |= static_cast<std::uint64_t>(!in) << i;
  }
  return outside;
}

template <typename T>
bool all_inside(const T* rows, std::size_t count, const geometry::Box& box) {
  constexpr std::size_t kRows = 8;  // together, so that the compiler makes vectors of them
  std::array<double, 3 * kRows> lo, hi;
  for (std::size_t i = 0; i < lo.size(); ++i) {
    lo[i] = box.lo[i % 3];
    hi[i] = box.hi[i % 3];
  }
  std::size_t i = 0;
  for (; i + kRows <= count; i += kRows) {
    std::int64_t outside = 0;
    for (std::size_t k = 0; k < lo.size(); ++k) {
      const double x = rows[3 * i + k];
      outside += x > lo[k] ? 0 : 1;
      outside += x < hi[k] ? 0 : 1;
    }
    if (outside != 0) return false;
  }
  for (i *= 3; i < 3 * count; ++i)
    if (!(rows[i] > lo[i % 3] && rows[i] < hi[i % 3])) return false;
  return true;
}

template <typename D>
hn::Vec<D> load_as_double(D d, const double* x) {
  return hn::LoadU(d, x);
}
template <typename D>
hn::Vec<D> load_as_double(D d, const float* x) {
  return hn::PromoteTo(d, hn::LoadU(hn::Rebind<float, D>(), x));
}

template <typename T>
std::uint64_t outside_own_rows(const T* rows, std::size_t count, const geometry::Box* boxes, const std::int32_t* part) {
  static_assert(sizeof(geometry::Box) == 6 * sizeof(double), "lo, then hi");
  const hn::CappedTag<double, 4> d;
  const hn::RebindToUnsigned<decltype(d)> bits;
  std::uint64_t outside = 0;
  std::size_t i = 0;
  if constexpr (hn::MaxLanes(d) == 4) {
    // A row at a time: of the four values that a load takes, three count, and the last row is left.
    HWY_ALIGN constexpr std::array<std::int64_t, 4> kUpper{1, 2, 3, 3};
    const auto upper = SetTableIndices(d, kUpper.data());
    auto bit = hn::Set(bits, std::uint64_t{1});
    auto found = hn::Zero(bits);
    for (; i + 1 < count; ++i) {
      const double* const lo = boxes[part[i]].lo.data();
      const auto x = load_as_double(d, rows + 3 * i);
      const auto in = hn::And(hn::Gt(x, hn::LoadU(d, lo)), hn::Lt(x, TableLookupLanes(hn::LoadU(d, lo + 2), upper)));
      found = hn::Or(found, hn::IfThenZeroElse(hn::RebindMask(bits, in), bit));
      bit = hn::Add(bit, bit);
    }
    outside = any_lane<3>(found);
  }
  for (; i < count; ++i) {
    const geometry::Box& box = boxes[part[i]];
    bool in = true;
    for (std::size_t a = 0; a < 3; ++a) in = in & (rows[3 * i + a] > box.lo[a]) & (rows[3 * i + a] < box.hi[a]);
    outside |= static_cast<std::uint64_t>(!in) << i;
  }
  return outside;
}

// The following are plain steps that compilers make vectors of.

void scale(const double* weight, std::size_t count, std::int64_t scale, ScaledWeights& to) {
  std::uint64_t as_zero = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const auto bits = std::bit_cast<std::int64_t>(weight[i]);
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
  to.as_zero = as_zero;
}

QuickSum sum(const double* weight, std::size_t count, int scale) {
  constexpr std::size_t kLanes = std::max<std::size_t>(hn::MaxLanes(hn::ScalableTag<double>()), 2);
  using Lanes = double __attribute__((vector_size(kLanes * sizeof(double))));
  const double at_upper = std::ldexp(1.5, QuickSum::kUpper + 52 - scale);
  const double at_middle = std::ldexp(1.5, QuickSum::kMiddle + 52 - scale);
  const Lanes limit = Lanes{} + std::ldexp(1.0, 52 - scale);
  const Lanes zero{};
  Lanes upper{}, middle{}, lower{};
  auto small = limit > limit;
  for (std::size_t i = 0; i < count; i += kLanes) {
    Lanes own;
    std::memcpy(&own, weight + i, sizeof own);
    small |= (own < limit) & (own > zero);
    const Lanes high = (own + at_upper) - at_upper;
    const Lanes rest = own - high;
    const Lanes mid = (rest + at_middle) - at_middle;
    upper += high;
    middle += mid;
    lower += rest - mid;
  }
  QuickSum to;
  for (std::size_t k = 0; k < kLanes; ++k) {
    to.upper += upper[k];
    to.middle += middle[k];
    to.lower += lower[k];
    to.small = to.small || small[k] != 0;
  }
  return to;
}

IdSums sum_ids(std::span<const particles::Id> ids, std::uint64_t key) {
  IdSums sums;
  particles::Id sign = 0;
  for (std::size_t i = 0; i < ids.size(); ++i) {
    const std::uint64_t mixed = mix64(static_cast<std::uint64_t>(ids[i]) + key);
    sums.any_order += mixed;
    sums.in_order += mixed * (i + 1);
    sign |= ids[i];
  }
  sums.negative = sign < 0;
  return sums;
}

constexpr Kernels kKernels{descend,
                           outside_own,
                           outside,
                           {all_inside<double>, outside_own_rows<double>},
                           {all_inside<float>, outside_own_rows<float>},
                           scale,
                           sum,
                           sum_ids};

}  // namespace rcb::cuts::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace rcb::cuts {

const Kernels& kernels() { return RCB_OF_INSTRUCTION_SET(kKernels, instruction_set()); }

IdSums sum_ids(std::span<const particles::Id> ids, std::uint64_t key) { return kernels().sum_ids(ids, key); }

}  // namespace rcb::cuts
#endif
