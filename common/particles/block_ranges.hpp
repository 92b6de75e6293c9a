// The ranges of the coordinates of 64 particles each: made by whoever reads the positions anyhow, so that others need
// not read most of them again.
#pragma once

#include <array>
#include <cstddef>
#include <limits>
#include <span>

#include "common/base/buffer.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::particles {

inline constexpr std::size_t kBlock = 64;  // particles; the last block of an array may have less
constexpr std::size_t blocks_of(std::size_t count) { return (count + kBlock - 1) / kBlock; }

struct Range {
  double lo = std::numeric_limits<double>::infinity();  // lo > hi: of no value
  double hi = -std::numeric_limits<double>::infinity();

  static constexpr Range everything() { return {Range{}.hi, Range{}.lo}; }
  bool strictly_inside(double low, double high) const { return lo > low && hi < high; }
  void extend(const Range& other) {
    lo = other.lo < lo ? other.lo : lo;
    hi = other.hi > hi ? other.hi : hi;
  }
};

// Of these values; everything where one is not a number.
Range range_of(std::span<const double> values);

// By axis and block. Axes that there aren't have none.
struct BlockRanges {
  std::array<Buffer<Range>, geometry::kDimsMax> of;

  // Of no values yet.
  void reset(int dims, std::size_t count) {
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) {
      of[a].resize(blocks_of(count));
      for (Range& range : of[a]) range = {};
    }
  }
};

// One read of the positions.
BlockRanges ranges_of(const ParticleView& particles);

}  // namespace rcb::particles
