// SortedSample: a sample in ascending order on every axis, from which a tree's cuts are read off: a node's sampled
// particles are a range in which each axis keeps its order, as in the construction of k-d trees from presorted points.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/base/index.hpp"
#include "common/geometry/box.hpp"
#include "common/partition/search/rounded_axes.hpp"
#include "common/partition/search/sample.hpp"
#include "common/partition/tree/key.hpp"

namespace rcb::partition {

class SortedSample {
 public:
  // Sampled particles of one node.
  struct Range {
    std::size_t first = 0;
    std::size_t last = 0;
    std::size_t size() const { return last - first; }
  };

  SortedSample() = default;
  // `sample` must outlive this. The order is that of the rounded coordinates.
  explicit SortedSample(const Sample& sample);

  const Sample& sample() const { return *sample_; }
  Range all() const { return {0, side_.size()}; }
  // The sampled particles of a range, ascending on this axis.
  std::span<const std::uint32_t> particles(const Range& range, std::size_t axis) const {
    return std::span(order_[axis]).subspan(range.first, range.size());
  }
  // The k-th coordinate.
  double x(const Range& range, std::size_t axis, std::size_t k) const {
    return sample_->x(axis, order_[axis][range.first + k]);
  }
  // The bounding box of a range; empty if it holds none.
  geometry::Box box(const Range& range) const;
  Point extents(const Range& range) const;
  const RoundedAxes& rounded() const { return rounded_; }
  // How many of a range have a coordinate that is less than x, and how many one that is not greater, all rounded.
  std::size_t below(const Range& range, std::size_t axis, double x) const;
  std::size_t up_to(const Range& range, std::size_t axis, double x) const;
  // Divides a range: the first `left` on this axis come first.
  void split(const Range& range, std::size_t axis, std::size_t left);
  // Divides a range: those for which left(particle) holds come first. Returns how many they are.
  template <typename Left>
  std::size_t divide(const Range& range, Left left) {
    std::size_t lefts = 0;
    for (const std::uint32_t k : particles(range, 0)) {
      side_[k] = left(k) ? 0 : 1;
      lefts += 1U - side_[k];
    }
    for (std::size_t a = 0; a < at(sample_->particles.dims); ++a) divide_axis(range, a);
    return lefts;
  }

 private:
  void sort(std::size_t axis);
  // By side_.
  void divide_axis(const Range& range, std::size_t axis);

  const Sample* sample_ = nullptr;
  std::array<std::vector<std::uint32_t>, geometry::kDimsMax> order_;  // of the sampled particles, by axis
  RoundedAxes rounded_;
  std::vector<std::uint8_t> side_;  // of each sampled particle: 1: right
  std::vector<std::uint32_t> right_;
};

}  // namespace rcb::partition
