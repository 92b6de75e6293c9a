// Box: an axis-aligned box. By default it is empty, which is the neutral element of a reduction.
#pragma once

#include <algorithm>
#include <array>
#include <limits>
#include <span>

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

// Widens the interval from lo to hi so that it holds these values. With four accumulators each, since every step of one
// would wait for the step before.
inline void least_and_most(std::span<const double> values, double& lo, double& hi) {
  std::array<double, 4> least;
  std::array<double, 4> most;
  least.fill(lo);
  most.fill(hi);
  std::size_t i = 0;
  for (; i + 4 <= values.size(); i += 4)
    for (std::size_t k = 0; k < 4; ++k) {
      const double value = values[i + k];
      least[k] = value < least[k] ? value : least[k];
      most[k] = value > most[k] ? value : most[k];
    }
  for (; i < values.size(); ++i) {
    least[0] = std::min(least[0], values[i]);
    most[0] = std::max(most[0], values[i]);
  }
  lo = *std::ranges::min_element(least);
  hi = *std::ranges::max_element(most);
}

}  // namespace rcb::geometry
