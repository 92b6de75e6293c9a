// Room `points`: quantised points, and how coordinates become integers. The points of a tree node lie side by side, in
// few segments, so a level of the tree takes a few linear passes over memory, and the particles stay where they are.
//
// Segment: some of a node's quantised points, side by side.
#pragma once

#include <cstdint>
#include <span>

#include "common/partition/kernels/block.hpp"

namespace rcb::partition {

// Integers on one axis, lo to hi, both included; lo > hi: none.
struct Interval {
  std::int32_t lo = 0;
  std::int32_t hi = -1;

  static constexpr Interval everything() { return {0, LinearMaps::kTop}; }
  bool empty() const { return lo > hi; }
  bool meets(const Interval& other) const { return other.lo <= hi && other.hi >= lo; }
};

// While a cut is searched, the points before `middle` are known to go left, those from `upper` on to go right, and
// those between them are undecided.
struct Segment {
  QuantisedPoint* first = nullptr;
  QuantisedPoint* middle = nullptr;
  QuantisedPoint* upper = nullptr;
  QuantisedPoint* last = nullptr;
  std::uint64_t base = 0;  // particle base + index is this rank's particle of that index
  QBounds bounds;          // exact

  std::size_t size() const { return static_cast<std::size_t>(last - first); }
  std::span<QuantisedPoint> all() const { return {first, last}; }
  std::span<QuantisedPoint> undecided() const { return {middle, upper}; }
};

// Points that all end in one part.
struct PointsOfPart {
  std::span<const QuantisedPoint> points;
  std::uint64_t base;  // as a segment's
  std::int32_t part;
};

// Moves the points with q < first_right on this axis to the front; returns where the others begin. Local.
QuantisedPoint* divide(std::span<QuantisedPoint> points, std::size_t axis, std::int32_t first_right);

// Adds one to bin (q - lo) >> shift of one of two tables for each point; q in [lo, lo + (bins << shift)). Two, since
// neighbours often fall into the same bin, and its increments would wait for each other. Local.
void count_bins(std::span<const QuantisedPoint> points, std::size_t axis, std::int32_t lo, unsigned shift,
                std::span<std::uint64_t> even, std::span<std::uint64_t> odd);

}  // namespace rcb::partition
