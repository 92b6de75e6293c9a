// AxisMap: the map from an axis' coordinates to integers.
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <span>

#include "common/partition/kernels/block.hpp"

namespace rcb::partition {

// The right shift that makes 0..span fit in `bits` bits.
constexpr unsigned shift_to(std::uint64_t span, unsigned bits) {
  const auto width = static_cast<unsigned>(std::bit_width(span));
  return width > bits ? width - bits : 0;
}

// Maps a coordinate to an integer in [0, kTop], in equal steps of the value or, where that would put too many particles
// into one step, in equal steps of the order-preserving bits. It keeps the order: map(a) < map(b) implies a < b.
// Coordinates beyond the range that a map was made for share its first or its last integer, so a map may be made before
// all particles are known; set_range() then tells how far they reach.
class AxisMap {
 public:
  static constexpr std::int32_t kTop = LinearMaps::kTop;

  AxisMap() = default;
  // By value, with a power of two as step, if the range allows it (it is neither a point nor tiny); else by
  // order-preserving bits. lo <= hi, finite.
  static AxisMap by_value(double lo, double hi);
  static AxisMap by_order_bits(double lo, double hi);

  bool linear() const { return scale_ > 0; }  // equal steps of the value
  // The exact range of all particles. By default they may lie anywhere.
  void set_range(double lo, double hi);

  double half_base() const { return half_base_; }
  double scale() const { return scale_; }

  std::int32_t operator()(double value) const {
    if (linear()) {
      const double q = (value * 0.5 - half_base_) * scale_;
      return q <= 0 ? 0 : q >= kTop ? kTop : static_cast<std::int32_t>(q);
    }
    const std::uint64_t bits = geometry::order_bits(value);
    return static_cast<std::int32_t>(bits <= lo_ ? 0 : (std::min(bits, hi_) - lo_) >> shift_);
  }

  // True if the integer determines the coordinate. A map by order-preserving bits with steps of 1 is, if no particle
  // lies beyond its range; one by value may turn out to be for a particle set (lattices, coordinates of few digits).
  bool lossless() const { return lossless_; }
  // Makes the map lossless, with all integers multiples of 2^zeros; or not lossless any more.
  void set_lossless(unsigned zeros) {
    lossless_ = true;
    zeros_ = zeros;
  }
  void set_lossy() {
    lossless_ = false;
    zeros_ = 0;
  }
  unsigned zeros() const { return zeros_; }
  // The coordinate of integer q, if the map is lossless.
  double value(std::int32_t q) const {
    return linear() ? 2 * (half_base_ + q / scale_)
                    : geometry::value_of_order_bits(lo_ + (static_cast<std::uint64_t>(q) << shift_));
  }
  // Every particle's coordinate whose integer is q lies in [least(q), most(q)].
  double least(std::int32_t q) const;
  double most(std::int32_t q) const;
  // The least double in the particles' range whose integer is at least q.
  double first_value(std::int32_t q) const;

 private:
  double half_base_ = 0;
  double scale_ = 0;
  std::uint64_t lo_ = 0;  // order-preserving bits
  std::uint64_t hi_ = 0;
  unsigned shift_ = 0;
  bool lossless_ = false;
  unsigned zeros_ = 0;
  double range_lo_ = -geometry::Box::kInfinity;
  double range_hi_ = geometry::Box::kInfinity;
};

using AxisMaps = std::array<AxisMap, geometry::kDimsMax>;

// True if all axes are mapped by value. Local.
inline bool all_linear(const AxisMaps& maps, int dims) {
  return std::all_of(maps.begin(), maps.begin() + dims, [](const AxisMap& map) { return map.linear(); });
}

// Whether a pass is to find out if maps are lossless. Local.
inline bool may_be_lossless(const AxisMaps& maps, int dims) {
  return all_linear(maps, dims) && std::ranges::any_of(maps, &AxisMap::lossless);
}

// How an axis is mapped, as rank 0 tells it to all.
struct AxisPlan {
  double lo = geometry::Box::kInfinity;  // lo > hi: there is no particle
  double hi = -geometry::Box::kInfinity;
  bool by_order_bits = false;
  bool maybe_lossless = false;  // it is for a sample, so the pass that quantises finds out

  AxisMap map() const;
};

// The plan for coordinates in [lo, hi], of which these are some. Where equal steps of the value put most of them into
// one bin and equal steps of the order-preserving bits don't, the latter suit the axis (many decades of scale). Local.
AxisPlan plan_axis(double lo, double hi, std::span<const double> some);
// The same where [lo, hi] is the range of a sample only: the plan's range is wider by half on either side. Local.
AxisPlan plan_sampled_axis(double lo, double hi, std::span<const double> some);

}  // namespace rcb::partition
