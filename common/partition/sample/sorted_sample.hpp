// SortedSample: a sample in ascending order on every axis, from which a tree's cuts are read off: a node's sampled
// particles are a range in which each axis keeps its order, as in the construction of k-d trees from presorted points.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "common/base/index.hpp"
#include "common/geometry/box.hpp"
#include "common/partition/kernels/block.hpp"
#include "common/partition/sample/sample.hpp"

namespace rcb::partition {

class SortedSample {
 public:
  // Sampled particles of one node: places in the order of each axis.
  struct Range {
    std::size_t first = 0;
    std::size_t last = 0;
    std::size_t outermost_first = 0;  // and those of the outermost particles that lie in the node
    std::size_t outermost_last = 0;
    std::size_t size() const { return last - first; }
  };
  struct Halves {
    Range left;
    Range right;
  };

  // `sample` must outlive this.
  explicit SortedSample(const Sample& sample);

  const Sample& sample() const { return *sample_; }
  Range all() const { return {0, side_.size(), 0, outermost_.size()}; }
  // Particles that boxes are to hold, though they aren't sampled.
  void set_outermost(const Sample& outermost);
  // The k-th on this axis: its index in the sample, and its coordinate.
  std::size_t index(const Range& range, std::size_t axis, std::size_t k) const { return order_[axis][range.first + k]; }
  double x(const Range& range, std::size_t axis, std::size_t k) const {
    return sample_->x(axis, index(range, axis, k));
  }
  // The bounding box of a range, with its outermost particles; empty if it holds none.
  geometry::Box box(const Range& range) const;
  geometry::Point extents(const Range& range) const;
  const RoundedAxes& rounded() const { return rounded_; }
  // How many of a range have a coordinate that is less than x.
  std::size_t below(const Range& range, std::size_t axis, double x) const;
  // Divides a range: the first `left` on this axis come first.
  Halves split(const Range& range, std::size_t axis, std::size_t left);

 private:
  void sort(std::size_t axis);

  const Sample* sample_;
  std::array<std::vector<std::uint32_t>, geometry::kDimsMax> order_;  // of the sampled particles, by axis
  RoundedAxes rounded_;
  std::vector<std::uint8_t> side_;  // of each sampled particle: 1: right
  std::vector<std::uint32_t> right_;
  std::vector<geometry::Point> outermost_;
};

}  // namespace rcb::partition
