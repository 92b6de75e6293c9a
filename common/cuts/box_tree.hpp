// BoxTree: which of P boxes are within a width of another one. A box that is near all boxes of a subtree is found
// there, for all of its parts at once.
#pragma once

#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "common/base/index.hpp"
#include "common/cuts/cut_tree.hpp"
#include "common/cuts/periodic.hpp"

namespace rcb::cuts {

// Whether a distance, given by its part along each axis, is at most a width. Rounding is monotonic, so what is near a
// box is near every box that holds it, in floating point too.
class Within {
 public:
  Within(Norm norm, double width) : euclid_(norm == Norm::euclid), limit_(euclid_ ? width * width : width) {}
  bool operator()(double gap) const { return (euclid_ ? gap * gap : gap) <= limit_; }
  bool operator()(const Point& gaps) const {
    if (euclid_) return gaps[0] * gaps[0] + gaps[1] * gaps[1] + gaps[2] * gaps[2] <= limit_;
    return gaps[0] <= limit_ && gaps[1] <= limit_ && gaps[2] <= limit_;
  }

  // A point as vectors. Comparisons of these need no branches, which nobody could predict.
  struct Lanes {
    using Pair = double __attribute__((vector_size(16)));
    Pair xy{};
    Pair z{};  // and 0

    Lanes() = default;
    explicit Lanes(const Point& p) : xy{p[0], p[1]}, z{p[2], 0} {}
    Lanes operator+(const Lanes& other) const {
      Lanes sum;
      sum.xy = xy + other.xy;
      sum.z = z + other.z;
      return sum;
    }
  };
  struct Bounds {
    Lanes lo, hi;
  };
  // The same as operator() of the distance of y from the box.
  bool near(const Bounds& box, const Lanes& y) const {
    if (euclid_) return near_by_squares(box, y);
    const auto beyond = (box.lo.xy - y.xy > limit_) | (y.xy - box.hi.xy > limit_) | (box.lo.z - y.z > limit_) |
                        (y.z - box.hi.z > limit_);
    return (beyond[0] | beyond[1]) == 0;
  }

 private:
  static Lanes::Pair gap(const Lanes::Pair& lo, const Lanes::Pair& hi, const Lanes::Pair& y) {
    const Lanes::Pair longest = lo - y > y - hi ? lo - y : y - hi;
    return longest > 0.0 ? longest : Lanes::Pair{};
  }
  bool near_by_squares(const Bounds& box, const Lanes& y) const {
    const Lanes::Pair xy = gap(box.lo.xy, box.hi.xy, y.xy);
    const Lanes::Pair z = gap(box.lo.z, box.hi.z, y.z);
    return xy[0] * xy[0] + xy[1] * xy[1] + z[0] * z[0] <= limit_;
  }

  bool euclid_;
  double limit_;
};

// The distance of [lo, hi] from the box on an axis. None of these is infinite but bounds of the box.
inline double gap_of(const geometry::Box& box, std::size_t axis, double lo, double hi) {
  return std::max(std::max(box.lo[axis] - hi, lo - box.hi[axis]), 0.0);
}

class BoxTree {
 public:
  // leaves: one a part; a box without points, geometry::Box{}, is far from everything.
  BoxTree(std::vector<geometry::Box> leaves, int dims)
      : leaves_(std::move(leaves)), inner_(leaves_.size()), dims_(at(dims)) {
    build(root());
  }

  const std::vector<geometry::Box>& leaves() const { return leaves_; }
  geometry::Box around() const { return of(root()).around; }

  // Calls visit(first, last) for ranges that together are the parts whose boxes are within the width of `box`, which
  // has finite bounds; ascending. Returns how many boxes were looked at.
  template <typename Visit>
  std::uint64_t near(const geometry::Box& box, const Within& within, const Visit& visit) const {
    return descend(root(), box, within, visit);
  }

 private:
  // Of the boxes of a subtree: the box around all, and the one from the greatest of their lower faces to the least of
  // their upper ones, which is as far from another box, along each axis, as the farthest of them.
  struct Bounds {
    geometry::Box around;
    geometry::Box farthest;
  };

  NodeRange root() const { return {0, 0, static_cast<int>(leaves_.size())}; }
  Bounds of(const NodeRange& range) const {
    if (!range.leaf()) return inner_[at(range.node)];
    return {leaves_[at(range.first)], leaves_[at(range.first)]};
  }
  void build(const NodeRange& range) {
    if (range.leaf()) return;
    build(range.left());
    build(range.right());
    Bounds bounds = of(range.left());
    const Bounds right = of(range.right());
    bounds.around.extend(right.around);
    for (std::size_t a = 0; a < dims_; ++a) {
      bounds.farthest.lo[a] = std::max(bounds.farthest.lo[a], right.farthest.lo[a]);
      bounds.farthest.hi[a] = std::min(bounds.farthest.hi[a], right.farthest.hi[a]);
    }
    inner_[at(range.node)] = bounds;
  }
  bool is_near(const geometry::Box& own, const geometry::Box& box, const Within& within) const {
    Point gaps{};
    for (std::size_t a = 0; a < dims_; ++a) gaps[a] = gap_of(own, a, box.lo[a], box.hi[a]);
    return within(gaps);
  }
  template <typename Visit>
  std::uint64_t descend(const NodeRange& range, const geometry::Box& box, const Within& within,
                        const Visit& visit) const {
    if (!is_near(range.leaf() ? leaves_[at(range.first)] : inner_[at(range.node)].around, box, within)) return 1;
    if (range.leaf() || is_near(inner_[at(range.node)].farthest, box, within)) {
      visit(range.first, range.last);
      return 1;
    }
    return 1 + descend(range.left(), box, within, visit) + descend(range.right(), box, within, visit);
  }

  std::vector<geometry::Box> leaves_;
  std::vector<Bounds> inner_;
  std::size_t dims_;
};

}  // namespace rcb::cuts
