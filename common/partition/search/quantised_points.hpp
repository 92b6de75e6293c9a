// Quantised points: what the search reads and moves instead of the particles: 16 bytes each, the coordinates as 31-bit
// integers and the particle's index. The quantised points of a tree node lie side by side, in few spans, so a level of
// the tree takes a few linear passes over memory, and the particles stay where they are.
//
// Invariants
// 1. Quantising preserves order: q(a) < q(b) implies a < b. Where integers are equal, the particles' coordinates
//    decide.
// 2. The map from coordinates to integers is the same on every rank.
// 3. Quantised points come in chunks, since a particle's index in its chunk has 32 bits.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <span>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::partition {

using Integers = std::array<std::int32_t, geometry::kDimsMax>;

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

// Some of a node's quantised points, all in one chunk. Those before `middle` are known to go left, those from `upper`
// on to go right.
struct Span {
  static constexpr std::int32_t kNoBucket = -1;

  QuantisedPoint* first = nullptr;
  QuantisedPoint* middle = nullptr;
  QuantisedPoint* upper = nullptr;
  QuantisedPoint* last = nullptr;
  // [replaced, replaced_last): the quantised points whose integers on the cut axis are replaced by another key word for
  // now.
  QuantisedPoint* replaced = nullptr;
  QuantisedPoint* replaced_last = nullptr;
  std::uint64_t base = 0;           // the chunk's first particle
  QBounds bounds;                   // exact, if known
  std::int32_t bucket = kNoBucket;  // it holds all of this bucket in the chunk

  std::size_t size() const { return static_cast<std::size_t>(last - first); }
  std::span<QuantisedPoint> all() const { return {first, last}; }
  std::span<QuantisedPoint> open() const { return {middle, upper}; }
};

// The right shift that makes 0..span fit in `bits` bits.
constexpr unsigned shift_to(std::uint64_t span, unsigned bits) {
  const auto width = static_cast<unsigned>(std::bit_width(span));
  return width > bits ? width - bits : 0;
}

// Maps a coordinate to an integer in [0, kTop], in equal steps of the value or, where that would put too many particles
// into one step, in equal steps of the order-preserving bits.
class AxisMap {
 public:
  static constexpr std::int32_t kTop = 0x7FFFFFFE;

  AxisMap() = default;
  // By value, with a power of two as step, if the range allows it (it is neither a point nor tiny); else by
  // order-preserving bits. lo <= hi, finite.
  static AxisMap by_value(double lo, double hi);
  static AxisMap by_order_bits(double lo, double hi);

  bool linear() const { return scale_ > 0; }  // equal steps of the value
  double half_base() const { return half_base_; }
  double scale() const { return scale_; }

  std::int32_t operator()(double value) const {
    return linear() ? static_cast<std::int32_t>((value * 0.5 - half_base_) * scale_)
                    : static_cast<std::int32_t>((geometry::order_bits(value) - lo_) >> shift_);
  }

  // True if the integer determines the coordinate. A map by order-preserving bits with steps of 1 always is lossless;
  // one by value may turn out to be for a particle set (lattices, coordinates of few digits).
  bool lossless() const { return lossless_; }
  // Makes the map lossless, with all integers multiples of 2^zeros.
  void set_lossless(unsigned zeros) {
    lossless_ = true;
    zeros_ = zeros;
  }
  unsigned zeros() const { return zeros_; }
  // The coordinate of integer q, if the map is lossless.
  double value(std::int32_t q) const {
    return linear() ? 2 * (half_base_ + q / scale_)
                    : geometry::value_of_order_bits(lo_ + (static_cast<std::uint64_t>(q) << shift_));
  }
  // Every coordinate whose integer is q lies in [least(q), most(q)].
  double least(std::int32_t q) const;
  double most(std::int32_t q) const;
  // The least double whose integer is at least q.
  double first_value(std::int32_t q) const;

 private:
  double half_base_ = 0;
  double scale_ = 0;
  std::uint64_t lo_ = 0;  // order-preserving bits
  std::uint64_t hi_ = 0;
  unsigned shift_ = 0;
  bool lossless_ = false;
  unsigned zeros_ = 0;
};

using AxisMaps = std::array<AxisMap, geometry::kDimsMax>;

// Which particles are quantised, and how they are grouped.
struct Roots {
  static constexpr std::int32_t kNone = -1;
  std::size_t count = 1;
  std::span<const std::int32_t> part;  // [particles]
  // [parts]: the root that has this part, or kNone: left out; empty: there is one root, and it has all particles
  std::span<const std::int32_t> root_of;

  bool one() const { return root_of.empty(); }
  std::int32_t of(std::size_t i) const { return one() ? 0 : root_of[static_cast<std::size_t>(part[i])]; }
};

class QuantisedPoints {
 public:
  // Makes one quantised point per particle, grouped by bucket or, if `bucket` is empty, by root. If `check_lossless`
  // (only where all maps are by value), returns zeros_of_lossless() of every axis, found in the same pass; else -1.
  // Local.
  std::array<int, geometry::kDimsMax> build(const particles::ParticleView& particles, const AxisMaps& maps,
                                            std::size_t chunk_max, bool check_lossless, const Roots& roots,
                                            std::span<const std::uint8_t> bucket);

  std::size_t chunks() const { return chunks_.size(); }
  std::size_t size() const;
  // [group * chunks + chunk]: the quantised points of each root or bucket.
  std::vector<Span> spans();

 private:
  struct Chunk {
    Buffer<QuantisedPoint> points;
    std::vector<std::size_t> ends;  // [roots, or buckets]
    std::uint64_t base = 0;         // its first particle
  };
  std::vector<Chunk> chunks_;
};

// The number of trailing zero bits that all integers share, if a map by value is lossless for these coordinates; else
// -1. Local.
int zeros_of_lossless(const AxisMap& map, std::span<const double> x);

// Passes over quantised points.

// Moves points with q < at on this axis to the front; returns where the others begin.
QuantisedPoint* split(std::span<QuantisedPoint> points, std::size_t axis, std::int32_t at);
// The same where these are expected to be few.
QuantisedPoint* split_few(std::span<QuantisedPoint> points, std::size_t axis, std::int32_t at);
// Moves points with q >= at (expected to be few) to the back; returns where they begin.
QuantisedPoint* split_few_back(std::span<QuantisedPoint> points, std::size_t axis, std::int32_t at);
// Adds one to bin (q - lo) >> shift of one of two tables for each point; q in [lo, lo + (bins << shift)). Two, since
// neighbours often fall into the same bin, and its increments would wait for each other.
void count_bins(std::span<const QuantisedPoint> points, std::size_t axis, std::int32_t lo, unsigned shift,
                std::span<std::uint32_t> even, std::span<std::uint32_t> odd);
void widen(QBounds& bounds, std::span<const QuantisedPoint> points);

}  // namespace rcb::partition
