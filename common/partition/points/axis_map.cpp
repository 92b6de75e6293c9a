#include "common/partition/points/axis_map.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace rcb::partition {
namespace {

using Limits = std::numeric_limits<double>;

constexpr unsigned kBitsOfOrder = 30;  // of an integer that is made of order-preserving bits

// The map loses nothing of these coordinates.
bool keeps_all(const AxisMap& map, std::span<const double> coordinates) {
  Lossless lossless;
  for (const double x : coordinates) lossless.look(0, x, map.value(map(x)), map(x));
  return lossless.zeros(0) >= 0;
}

}  // namespace

AxisMap AxisMap::by_value(double lo, double hi) {
  AxisMap map = by_order_bits(lo, hi);
  const double most = static_cast<double>(kTop) / geometry::extent(lo, hi);
  if (!std::isnormal(most)) return map;
  map.half_base_ = lo * 0.5;
  map.scale_ = std::ldexp(1.0, std::ilogb(most));
  map.lossless_ = false;
  return map;
}

AxisMap AxisMap::by_order_bits(double lo, double hi) {
  AxisMap map;
  map.lo_ = geometry::order_bits(lo);
  map.hi_ = geometry::order_bits(hi);
  map.shift_ = shift_to(map.hi_ - map.lo_, kBitsOfOrder);
  map.lossless_ = map.shift_ == 0;
  return map;
}

void AxisMap::set_range(double lo, double hi) {
  range_lo_ = lo;
  range_hi_ = hi;
  if (!linear() && (geometry::order_bits(lo) < lo_ || geometry::order_bits(hi) > hi_)) set_lossy();
}

// Rounding moves a coordinate by far less than one step before it is truncated to an integer: a margin of one step is
// enough.
double AxisMap::least(std::int32_t q) const {
  if (lossless_) return value(q);
  if (q <= 0) return range_lo_;
  const double x = linear() ? std::nextafter(2 * (half_base_ + (q - 1) / scale_), -Limits::infinity()) : value(q);
  return std::clamp(x, range_lo_, range_hi_);
}

double AxisMap::most(std::int32_t q) const {
  if (lossless_) return value(q);
  const std::uint64_t next = lo_ + ((static_cast<std::uint64_t>(q) + 1) << shift_);
  if (linear() ? q >= kTop : next > hi_) return range_hi_;
  const double x = linear() ? std::nextafter(2 * (half_base_ + (q + 2.0) / scale_), Limits::infinity())
                            : geometry::value_of_order_bits(next - 1);
  return std::clamp(x, range_lo_, range_hi_);
}

double AxisMap::first_value(std::int32_t q) const {
  std::uint64_t low = geometry::order_bits(range_lo_);
  std::uint64_t high = geometry::order_bits(range_hi_);
  while (low < high) {
    const std::uint64_t middle = low + (high - low) / 2;
    if ((*this)(geometry::value_of_order_bits(middle)) >= q)
      high = middle;
    else
      low = middle + 1;
  }
  return geometry::value_of_order_bits(low);
}

AxisMap AxisPlan::map() const {
  if (lo > hi) return {};
  return by_order_bits ? AxisMap::by_order_bits(lo, hi) : AxisMap::by_value(lo, hi);
}

AxisPlan plan_axis(double lo, double hi, std::span<const double> some) {
  if (lo > hi) return {};
  constexpr std::size_t kBins = 512;
  const auto fullest = [&](const AxisMap& map) {
    std::array<std::size_t, kBins> bins{};
    const auto top = static_cast<std::uint64_t>(std::max(map(hi), 1));
    for (const double x : some) ++bins[static_cast<std::uint64_t>(map(x)) * (kBins - 1) / top];
    return std::ranges::max(bins);
  };
  AxisPlan plan{.lo = lo, .hi = hi};
  plan.by_order_bits = fullest(AxisMap::by_value(lo, hi)) > 2 * fullest(AxisMap::by_order_bits(lo, hi));
  plan.maybe_lossless = plan.map().linear() && keeps_all(plan.map(), some);
  return plan;
}

AxisPlan plan_sampled_axis(double lo, double hi, std::span<const double> some) {
  AxisPlan plan = plan_axis(lo, hi, some);
  if (lo > hi) return plan;
  if (plan.map().linear()) {
    const double half = geometry::extent(lo, hi);
    // A multiple of a coarse power of two, so that lattices become integers with many trailing zeros.
    const double grid = std::ldexp(1.0, std::ilogb(half) - 1);
    plan.lo = std::max(std::floor((lo - half) / grid) * grid, Limits::lowest());
    plan.hi = std::min(hi + half, Limits::max());
    plan.maybe_lossless = keeps_all(plan.map(), some);
    return plan;
  }
  // By at least one step, so that particles beyond a plane don't share its integer.
  plan.by_order_bits = true;
  const std::uint64_t first = geometry::order_bits(lo);
  const std::uint64_t last = geometry::order_bits(hi);
  const std::uint64_t half = std::max<std::uint64_t>((last - first) / 2, 1);
  plan.lo = geometry::value_of_order_bits(first - std::min(half, first - geometry::order_bits(Limits::lowest())));
  plan.hi = geometry::value_of_order_bits(last + std::min(half, geometry::order_bits(Limits::max()) - last));
  return plan;
}

}  // namespace rcb::partition
