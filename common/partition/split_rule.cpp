#include "common/partition/split_rule.hpp"

#include "common/partition/load.hpp"

namespace rcb::partition {
namespace {

std::optional<int> band_axis(Method method) {
  switch (method) {
    case Method::bands_x:
      return 0;
    case Method::bands_y:
      return 1;
    case Method::bands_z:
      return 2;
    default:
      return std::nullopt;
  }
}

}  // namespace

SplitRule::SplitRule(const PartitionOptions& options, int axes)
    : options_(options), axes_(axes), band_axis_(band_axis(options.method)) {}

void SplitRule::set_all(std::uint64_t count, const Bounds& bounds) {
  size_upto_.assign(1, 0);
  for (const u128 size : exact_sizes(options_.part_sizes, options_.parts))
    size_upto_.push_back(size_upto_.back() + size);
  quota_upto_.clear();
  for (const u128 upto : size_upto_) quota_upto_.push_back(floor_share(count, upto, size_upto_.back()));
  fixed_axes_ = order_of({0, 0, options_.parts}, bounds);
}

AxisOrder SplitRule::axes_of(const NodeRange& range, const Bounds& bounds) const {
  return fixed() ? fixed_axes_ : order_of(range, bounds);
}

AxisOrder SplitRule::order_of(const NodeRange& range, const Bounds& bounds) const {
  Point extents{};
  for (std::size_t a = 0; a < static_cast<std::size_t>(axes_); ++a)
    if (bounds.lo[a] <= ~bounds.not_hi[a])
      extents[a] =
          geometry::extent(geometry::value_of_image(bounds.lo[a]), geometry::value_of_image(~bounds.not_hi[a]));
  const AxisOrder order = geometry::order_by_extent(extents, axes_);
  if (band_axis_) return geometry::with_first(order, *band_axis_, axes_);
  if (sticky() && axes_ > 0) {
    const Cut* old_cut = options_.previous->cut_of(range.first, range.last);
    if (old_cut != nullptr && old_cut->axes[0] < axes_ &&
        extents[static_cast<std::size_t>(old_cut->axes[0])] * options_.axis_hysteresis >=
            extents[static_cast<std::size_t>(order[0])])
      return geometry::with_first(order, old_cut->axes[0], axes_);
  }
  return order;
}

}  // namespace rcb::partition
