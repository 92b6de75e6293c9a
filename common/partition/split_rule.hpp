// SplitRule: what a node's particles decide about its cut before any search: the axis order, and how many particles
// go left. One truth for every way to find the cuts.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "common/base/wide.hpp"
#include "common/partition/partition.hpp"

namespace rcb::partition {

inline constexpr std::uint64_t kNoImage = ~std::uint64_t{0};

// Least image and complement of the greatest image on each axis: one minimum over ranks gives both. All kNoImage:
// no particle.
struct Bounds {
  std::array<std::uint64_t, geometry::kDimsMax> lo{kNoImage, kNoImage, kNoImage};
  std::array<std::uint64_t, geometry::kDimsMax> not_hi{kNoImage, kNoImage, kNoImage};
};

class SplitRule {
 public:
  // axes: how many axes can be cut; 0: ids alone. `options` must outlive this.
  SplitRule(const PartitionOptions& options, int axes);
  // The number and the bounds of all ranks' particles, once they are known. Local.
  void set_all(std::uint64_t count, const Bounds& bounds);

  // The axis order of a node with these bounds. Local.
  AxisOrder axes_of(const NodeRange& range, const Bounds& bounds) const;
  // Bands: one axis order for every node.
  bool fixed() const { return band_axis_.has_value(); }
  // Some node may keep the axis of the tree before.
  bool sticky() const { return options_.axis_hysteresis > 1 && options_.previous != nullptr; }
  int axes() const { return axes_; }

  // Without weights: the particles of parts [first, last) together.
  std::uint64_t quota(int first, int last) const {
    return quota_upto_[static_cast<std::size_t>(last)] - quota_upto_[static_cast<std::size_t>(first)];
  }
  // The exact sizes of parts [first, last) together.
  u128 size(int first, int last) const {
    return size_upto_[static_cast<std::size_t>(last)] - size_upto_[static_cast<std::size_t>(first)];
  }

 private:
  AxisOrder order_of(const NodeRange& range, const Bounds& bounds) const;

  const PartitionOptions& options_;
  int axes_;
  std::optional<int> band_axis_;
  AxisOrder fixed_axes_{0, 1, 2};
  std::vector<u128> size_upto_;
  std::vector<std::uint64_t> quota_upto_;
};

}  // namespace rcb::partition
