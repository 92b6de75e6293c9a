// The coordinate ranges of blocks of 64 particles, made by a pass that reads the positions anyway, so that later passes
// need not read most positions again.
#pragma once

#include <array>
#include <cstddef>
#include <limits>
#include <span>

#include "common/base/buffer.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::particles {

inline constexpr std::size_t kBlock = 64;  // particles; the last block of an array may have fewer
constexpr std::size_t blocks_of(std::size_t count) { return (count + kBlock - 1) / kBlock; }

struct Range {
  double lo = std::numeric_limits<double>::infinity();  // lo > hi: empty
  double hi = -std::numeric_limits<double>::infinity();

  static constexpr Range everything() { return {Range{}.hi, Range{}.lo}; }
  bool strictly_inside(double low, double high) const { return lo > low && hi < high; }
  void extend(const Range& other) {
    lo = other.lo < lo ? other.lo : lo;
    hi = other.hi > hi ? other.hi : hi;
  }
};

// The range of these values; Range::everything() if one of them is NaN.
Range range_of(std::span<const double> values);

// of[axis][block]; nothing for axes >= dims.
struct BlockRanges {
  std::array<Buffer<Range>, geometry::kDimsMax> of;

  bool known() const { return !of[0].empty(); }
};

}  // namespace rcb::particles
