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

  bool operator==(const Box&) const = default;
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
  // As extent(), of each side; 0 where it is empty, and on axes >= dims.
  Point extents(int dims) const {
    Point extents{};
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) extents[a] = std::max(extent(lo[a], hi[a]), 0.0);
    return extents;
  }
  // Changes nothing if `other` is empty.
  void extend(const Box& other) {
    for (std::size_t a = 0; a < kDimsMax; ++a) {
      lo[a] = std::min(lo[a], other.lo[a]);
      hi[a] = std::max(hi[a], other.hi[a]);
    }
  }
};

// Widens the interval from lo to hi so that it holds these values. As vectors, two at a time, since the compiler makes
// none of doubles' comparisons, and every step of one would wait for the step before.
inline void least_and_most(std::span<const double> values, double& lo, double& hi) {
  using Lanes = double __attribute__((vector_size(16), aligned(8), may_alias));
  constexpr std::size_t kLanes = 2;
  Lanes least[4] = {{lo, lo}, {lo, lo}, {lo, lo}, {lo, lo}};
  Lanes most[4] = {{hi, hi}, {hi, hi}, {hi, hi}, {hi, hi}};
  std::size_t i = 0;
  for (; i + 4 * kLanes <= values.size(); i += 4 * kLanes)
    for (std::size_t k = 0; k < 4; ++k) {
      const Lanes own = reinterpret_cast<const Lanes*>(values.data() + i)[k];
      least[k] = own < least[k] ? own : least[k];
      most[k] = own > most[k] ? own : most[k];
    }
  for (std::size_t k = 0; k < 4 * kLanes; ++k) {
    lo = std::min(lo, least[k / kLanes][k % kLanes]);
    hi = std::max(hi, most[k / kLanes][k % kLanes]);
  }
  for (; i < values.size(); ++i) {
    lo = std::min(lo, values[i]);
    hi = std::max(hi, values[i]);
  }
}

}  // namespace rcb::geometry
