// Regions: the open boxes of this rank's parts, and which particles lie in that of their own. NaN and infinity lie in
// none.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/geometry/box.hpp"
#include "common/particles/block_ranges.hpp"

namespace rcb::service {

class Regions {
 public:
  Regions() = default;
  // boxes: of the parts from first_part on.
  Regions(std::int32_t first_part, std::span<const geometry::Box> boxes);

  // Whether such values of an axis lie strictly within the region of this part.
  bool hold(std::size_t axis, std::int32_t part, const particles::Range& range) const {
    const auto p = static_cast<std::size_t>(part - first_part_);
    return range.strictly_inside(lo_[axis][p], hi_[axis][p]);
  }
  // Of at most 64 values of an axis a bit each: 1 where it doesn't lie strictly within the region of its own part.
  //   part  [values]: parts that have a region here
  std::uint64_t outside(std::size_t axis, std::span<const double> values, const std::int32_t* part) const;

 private:
  std::int32_t first_part_ = 0;
  std::size_t parts_ = 0;
  std::array<std::vector<double>, geometry::kDimsMax> lo_;  // [parts, or more]
  std::array<std::vector<double>, geometry::kDimsMax> hi_;
};

}  // namespace rcb::service
