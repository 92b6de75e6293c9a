// Regions: the open boxes of some parts, and the test whether a particle lies in the box of its own part. NaN and
// infinity lie in none.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/geometry/box.hpp"
#include "common/particles/block_ranges.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::cuts {

class Regions {
 public:
  Regions() = default;
  // boxes: those of the parts first_part, first_part + 1, ...
  Regions(std::int32_t first_part, std::span<const geometry::Box> boxes);

  // True if all values in `range` lie strictly within the part's region on this axis.
  bool hold(std::size_t axis, std::int32_t part, const particles::Range& range) const {
    const auto p = static_cast<std::size_t>(part - first_part_);
    return range.strictly_inside(lo_[axis][p], hi_[axis][p]);
  }
  // For at most 64 values of an axis, a bit each: 1 if the value is not strictly within the region of its own part.
  //   part  [values]: parts that have a region here
  std::uint64_t outside(std::size_t axis, std::span<const double> values, const std::int32_t* part) const;

 private:
  std::int32_t first_part_ = 0;
  std::size_t parts_ = 0;
  std::array<std::vector<double>, geometry::kDimsMax> lo_;  // [at least parts]
  std::array<std::vector<double>, geometry::kDimsMax> hi_;
};

// For at most 64 positions, a bit each: 1 if the position is not strictly inside the box. x: three arrays, whatever the
// dimensions.
std::uint64_t outside_of(const particles::Axes& x, std::size_t count, const geometry::Box& box);

}  // namespace rcb::cuts
