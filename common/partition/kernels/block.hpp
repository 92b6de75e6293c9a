// Room `kernels`: loops over particles in vector instructions, each written once for all instruction sets.
//
// What they read and write: blocks of 64 particles.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <span>

#include "common/base/prefetch.hpp"
#include "common/geometry/box.hpp"
#include "common/particles/block_ranges.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::partition {

using particles::Axes;
using particles::kBlock;

using Integers = std::array<std::int32_t, geometry::kDimsMax>;

// What the search reads and moves instead of a particle: its coordinates as integers that keep their order, and its
// index in its chunk.
struct alignas(16) QuantisedPoint {
  Integers q{};
  std::uint32_t index = 0;
};

// Bounds of quantised coordinates; lo > hi: there are none, or they aren't known.
struct QBounds {
  static constexpr std::int32_t kNone = 0x7FFFFFFF;
  Integers lo{kNone, kNone, kNone};
  Integers hi{-1, -1, -1};

  bool empty() const { return lo[0] > hi[0]; }
  void extend(const QBounds& other) {
    for (std::size_t a = 0; a < lo.size(); ++a) {
      lo[a] = std::min(lo[a], other.lo[a]);
      hi[a] = std::max(hi[a], other.hi[a]);
    }
  }
};

// A closed box as one cache line. Lanes beyond the last axis are unbounded.
struct alignas(64) Bounds {
  static constexpr double kInfinity = geometry::Box::kInfinity;
  std::array<double, 4> lo{-kInfinity, -kInfinity, -kInfinity, -kInfinity};
  std::array<double, 4> hi{kInfinity, kInfinity, kInfinity, kInfinity};

  static Bounds of(const geometry::Box& box, int dims) {
    Bounds bounds;
    std::copy_n(box.lo.begin(), dims, bounds.lo.begin());
    std::copy_n(box.hi.begin(), dims, bounds.hi.begin());
    return bounds;
  }
  // Makes it hold range_on(axis) on the first axes.
  template <typename RangeOn>
  void extend(std::size_t dims, const RangeOn& range_on) {
    for (std::size_t a = 0; a < dims; ++a) {
      lo[a] = std::min(lo[a], range_on(a).lo);
      hi[a] = std::max(hi[a], range_on(a).hi);
    }
  }
  geometry::Box box(int dims) const {
    geometry::Box box;
    std::copy_n(lo.begin(), dims, box.lo.begin());
    std::copy_n(hi.begin(), dims, box.hi.begin());
    return box;
  }
};

// Coordinates rounded to float, of which a pass over all particles compares eight or sixteen at once. Rounding keeps
// the order: of two coordinates, the lesser one is never the greater float. None becomes infinite, so that a node
// without a cut, whose bracket begins at infinity, keeps none.
struct RoundedAxes {
  geometry::Point origin{};
  geometry::Point scale{1, 1, 1};

  // Makes floats tell coordinates from lo to hi apart as well as they can: they are densest at 0.
  void fit(std::size_t axis, double lo, double hi) {
    if (lo > hi) return;
    origin[axis] = std::clamp(0.0, lo, hi);
    const double reach = std::max(hi * 0.5 - origin[axis] * 0.5, origin[axis] * 0.5 - lo * 0.5);
    const double factor = std::isnormal(reach) ? std::ldexp(1.0, -std::ilogb(reach)) : 1.0;
    if (std::isnormal(factor)) scale[axis] = factor;
  }
  float operator()(std::size_t axis, double x) const {
    return std::min(static_cast<float>((x - origin[axis]) * scale[axis]), std::numeric_limits<float>::max());
  }
};

// Where the upper cuts of a set are expected. A complete binary tree: node k has the children 2k + 1 and 2k + 2.
// Trivially copyable: it is sent as it is.
struct Splitters {
  static constexpr std::size_t kLevels = 6;
  static constexpr std::size_t kNodes = (std::size_t{1} << kLevels) - 1;
  static constexpr std::size_t kBuckets = 2 * kNodes + 1;  // one for each node and for each leaf

  // The node's cut is expected among the coordinates from `least` to `most`; greater ones go right. By default all go
  // left.
  struct Node {
    double least = geometry::Box::kInfinity;
    double most = geometry::Box::kInfinity;
    std::int32_t axis = 0;
  };

  std::array<Node, kNodes> nodes;
  RoundedAxes rounded;
};

// Maps from coordinates to integers in equal steps of the value: q = (x / 2 - base) * scale, clamped to [0, kTop] and
// truncated. Axes >= dims have scale 0.
struct LinearMaps {
  static constexpr std::int32_t kTop = 0x7FFFFFFE;
  alignas(32) std::array<double, 4> base{};
  alignas(32) std::array<double, 4> scale{};
  alignas(32) std::array<double, 4> step{};  // 1 / scale, exact
};

// What a pass learns of axes: whether quantising changed any coordinate, and the bits set in any integer.
struct Lossless {
  static constexpr std::int32_t kNoBits = std::int32_t{1} << 30U;
  alignas(32) std::array<std::int64_t, 4> differ{};
  alignas(16) std::array<std::int32_t, 4> bits{kNoBits, kNoBits, kNoBits, kNoBits};

  void look(std::size_t axis, double value, double again, std::int32_t q) {
    differ[axis] |= std::bit_cast<std::int64_t>(again - value);
    bits[axis] |= q;
  }
  // The number of trailing zero bits that all integers share, if each determines its coordinate; else -1. The shift
  // drops the sign: -0.0 is no difference either.
  int zeros(std::size_t axis) const {
    return differ[axis] << 1U != 0 ? -1 : std::countr_zero(static_cast<std::uint32_t>(bits[axis]));
  }
};

// The blocks of a particle set.
class Blocks {
 public:
  explicit Blocks(const particles::ParticleView& particles) : x_(particles.all_axes()), count_(particles.count) {}

  // The block that begins with particle `first`, until the next call. An incomplete one is filled up with its first
  // particle.
  const Axes& read(std::size_t first) {
    const std::size_t there = count_ - first;
    for (std::size_t a = 0; a < x_.size(); ++a) {
      block_[a] = x_[a] + first;
      for (std::size_t i = 0; i < kBlock; i += 8) prefetch(block_[a], kBlocksAhead * kBlock + i);
      if (there >= kBlock) continue;
      filled_[a].fill(block_[a][0]);
      std::copy_n(block_[a], there, filled_[a].begin());
      block_[a] = filled_[a].data();
    }
    return block_;
  }
  const Axes& last_read() const { return block_; }
  // One bit for each particle of that block.
  std::uint64_t present(std::size_t first) const {
    return count_ - first >= kBlock ? ~std::uint64_t{0} : (std::uint64_t{1} << (count_ - first)) - 1;
  }

 private:
  // The work on particles whose branches depend on data would otherwise wait for memory.
  static constexpr std::size_t kBlocksAhead = 16;
  Axes x_;
  Axes block_{};
  std::size_t count_;
  std::array<std::array<double, kBlock>, geometry::kDimsMax> filled_;
};

}  // namespace rcb::partition
