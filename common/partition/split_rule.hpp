// SplitRule: what a node's particles decide about its cut before any search: the axis order, and how many particles
// go left. One truth for every way to find the cuts.
#pragma once

#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "common/base/wide.hpp"
#include "common/partition/partition.hpp"

namespace rcb::partition {

// What is known of the extents of a node's particles.
struct Extents {
  Point least{};
  Point most{};
};

class SplitRule {
 public:
  // axes: how many axes can be cut; 0: ids alone. `options` must outlive this.
  SplitRule(const PartitionOptions& options, int axes);
  // The number and the exact extents of all ranks' particles, once they are known. Local.
  void set_all(std::uint64_t count, const Point& extents);
  // Other quotas than those of the whole set: the particles of parts [0, p) together, for p = 0..parts. Local.
  void set_quotas(std::vector<std::uint64_t> upto) { quota_upto_ = std::move(upto); }

  // The axis order of a node whose particles have these extents; nullopt where they leave it open. Local.
  std::optional<AxisOrder> axes_of(const NodeRange& range, const Extents& extents) const;
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
  // The axis of the tree before that a node may keep; negative: none.
  int old_axis(const NodeRange& range) const;
  AxisOrder order_of(const NodeRange& range, const Point& extents) const;

  const PartitionOptions* options_;  // never null; a pointer, so that a rule can be assigned
  int axes_;
  std::optional<int> band_axis_;
  AxisOrder fixed_axes_{0, 1, 2};
  std::vector<u128> size_upto_;
  std::vector<std::uint64_t> quota_upto_;
};

}  // namespace rcb::partition
