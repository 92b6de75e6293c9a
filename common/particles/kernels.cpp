#include "common/particles/block_ranges.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "common/particles/kernels.cpp"
#include "common/base/highway.hpp"

HWY_BEFORE_NAMESPACE();
namespace rcb::particles::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

Range range_of(const double* values, std::size_t count) {
  const hn::ScalableTag<double> d;
  // Two accumulators each, since every minimum depends on the one before it.
  auto lo = hn::Set(d, Range{}.lo);
  auto hi = hn::Set(d, Range{}.hi);
  auto other_lo = lo;
  auto other_hi = hi;
  auto unknown = hn::IsNaN(lo);
  std::size_t i = 0;
  for (; i + 2 * hn::Lanes(d) <= count; i += 2 * hn::Lanes(d)) {
    const auto x = hn::LoadU(d, values + i);
    const auto other = hn::LoadU(d, values + i + hn::Lanes(d));
    lo = hn::Min(x, lo);
    hi = hn::Max(x, hi);
    other_lo = hn::Min(other, other_lo);
    other_hi = hn::Max(other, other_hi);
    unknown = hn::Or(unknown, hn::Or(hn::IsNaN(x), hn::IsNaN(other)));
  }
  bool known = hn::AllFalse(d, unknown);
  Range range{hn::GetLane(hn::MinOfLanes(d, hn::Min(lo, other_lo))),
              hn::GetLane(hn::MaxOfLanes(d, hn::Max(hi, other_hi)))};
  for (; i < count; ++i) {
    range.extend({values[i], values[i]});
    known &= values[i] == values[i];
  }
  return known ? range : Range::everything();
}

constexpr auto* kRangeOf = range_of;

}  // namespace rcb::particles::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace rcb::particles {

Range range_of(std::span<const double> values) {
  return RCB_OF_INSTRUCTION_SET(kRangeOf, instruction_set())(values.data(), values.size());
}

}  // namespace rcb::particles
#endif
