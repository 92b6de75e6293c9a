// Box: an axis-aligned box. By default it is empty, which is the neutral element of a reduction.
#pragma once

#include <algorithm>
#include <limits>

#include "common/geometry/axes.hpp"

namespace rcb::geometry {

struct Box {
  static constexpr double kInfinity = std::numeric_limits<double>::infinity();
  Point lo{kInfinity, kInfinity, kInfinity};  // lo > hi: the box is empty
  Point hi{-kInfinity, -kInfinity, -kInfinity};

  static Box unbounded() { return {{-kInfinity, -kInfinity, -kInfinity}, {kInfinity, kInfinity, kInfinity}}; }
  bool empty(int dims) const {
    for (int a = 0; a < dims; ++a)
      if (lo[static_cast<std::size_t>(a)] > hi[static_cast<std::size_t>(a)]) return true;
    return false;
  }
  void extend(const Point& point, int dims) {
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) {
      lo[a] = std::min(lo[a], point[a]);
      hi[a] = std::max(hi[a], point[a]);
    }
  }
  // Changes nothing if `other` is empty.
  void extend(const Box& other) {
    for (std::size_t a = 0; a < kDimsMax; ++a) {
      lo[a] = std::min(lo[a], other.lo[a]);
      hi[a] = std::max(hi[a], other.hi[a]);
    }
  }
};

}  // namespace rcb::geometry
