// SplitRule: what a node's particles determine about its cut before any search: the axis order, and how many particles
// go left. Every way to find the cuts uses this one implementation.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "common/base/wide.hpp"
#include "common/partition/rules/request.hpp"

namespace rcb::partition {

// Bounds of a node's extents: on each axis the extent lies in [least, most].
struct Extents {
  Point least{};
  Point most{};
};

class SplitRule {
 public:
  // axes: how many there are. `options` must outlive this.
  SplitRule(const PartitionOptions& options, int axes);
  // Sets the number and the exact extents of all ranks' particles. Local.
  void set_all(std::uint64_t count, const Point& extents);

  // The axis order of a node with these extents; nullopt if they leave it open. Local.
  std::optional<AxisOrder> axes_of(const NodeRange& range, const Extents& extents) const;

  // Without weights: the particles of parts [first, last) together.
  std::uint64_t quota(int first, int last) const {
    return quota_prefix_[static_cast<std::size_t>(last)] - quota_prefix_[static_cast<std::size_t>(first)];
  }
  // The share of its left side in a node's load, rounded: for guesses, not for cuts.
  double left_share(const NodeRange& range) const;
  // The exact sizes of parts [first, last) together.
  u128 size(int first, int last) const {
    return size_prefix_[static_cast<std::size_t>(last)] - size_prefix_[static_cast<std::size_t>(first)];
  }

 private:
  // The previous tree's cut axis, which hysteresis may keep; negative: none.
  int old_axis(const NodeRange& range) const;
  AxisOrder order_of(const NodeRange& range, const Point& extents) const;

  const PartitionOptions* options_;  // never null; a pointer, so that a rule can be assigned
  int axes_;
  std::optional<int> band_axis_;
  AxisOrder fixed_axes_{0, 1, 2};
  std::vector<u128> size_prefix_;
  std::vector<std::uint64_t> quota_prefix_;
};

}  // namespace rcb::partition
