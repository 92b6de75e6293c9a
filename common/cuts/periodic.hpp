// Distances as halos are defined by: the maximum or the Euclidean norm, across periodic borders too.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>

#include "common/base/status.hpp"
#include "common/geometry/box.hpp"

namespace rcb::cuts {

enum class Norm { max, euclid };

// How many periods a position is moved along each axis.
using Shift = std::array<std::int32_t, geometry::kDimsMax>;

// The box that repeats itself. An axis with infinite bounds isn't periodic. The image number k of x is x + k * length:
// product and sum each rounded to double.
struct PeriodicBox : geometry::Box {
  PeriodicBox() : geometry::Box(unbounded()) {}
  PeriodicBox(const geometry::Point& low, const geometry::Point& high) : geometry::Box{low, high} {}

  bool periodic(std::size_t axis) const { return std::isfinite(lo[axis]) && std::isfinite(hi[axis]); }
  bool any(int dims) const {
    bool found = false;
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) found = found || periodic(a);
    return found;
  }
  double length(std::size_t axis) const { return hi[axis] - lo[axis]; }

  bool operator==(const PeriodicBox&) const = default;
};

// A distance from regions. A part's region is within the width of y if max(lo - y, y - hi, 0) of all axes, in `norm`,
// is at most `width` (Euclidean: the sum of squares, in the order of axes, at most width * width). lo and hi are the
// region's bounds; where it has none, infinite, or along a periodic axis those of `box`.
struct Near {
  double width = 0;
  Norm norm = Norm::max;
  PeriodicBox box{};

  bool operator==(const Near&) const = default;

  // Errors: invalid_argument (a width that is negative or not finite, a periodic axis without length).
  Status check(int dims) const;
};

}  // namespace rcb::cuts
