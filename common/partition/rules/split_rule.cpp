#include "common/partition/rules/split_rule.hpp"

#include <algorithm>

#include "common/partition/balance/load.hpp"

namespace rcb::partition {
SplitRule::SplitRule(const PartitionOptions& options, int axes)
    : options_(&options), axes_(axes), band_axis_(cuts::band_axis(options.method)) {
  size_prefix_.assign(1, 0);
  for (const u128 size : exact_sizes(options.part_sizes, options.parts))
    size_prefix_.push_back(size_prefix_.back() + size);
}

void SplitRule::set_all(std::uint64_t count, const Point& extents) {
  quota_prefix_.clear();
  for (const u128 prefix : size_prefix_) quota_prefix_.push_back(floor_share(count, prefix, size_prefix_.back()));
  fixed_axes_ = order_of({0, 0, options_->parts}, extents);
}

double SplitRule::left_share(const NodeRange& range) const {
  return static_cast<double>(size(range.first, range.middle())) / static_cast<double>(size(range.first, range.last));
}

std::optional<AxisOrder> SplitRule::axes_of(const NodeRange& range, const Extents& extents) const {
  if (band_axis_) return fixed_axes_;
  const auto axes = static_cast<std::size_t>(axes_);
  const auto& [least, most] = extents;
  double longest = 0;  // its lower bound
  double longest_most = 0;
  for (std::size_t a = 0; a < axes; ++a) {
    longest = std::max(longest, least[a]);
    longest_most = std::max(longest_most, most[a]);
    for (std::size_t b = 0; b < a; ++b) {
      const bool known = least[a] == most[a] && least[b] == most[b];
      if (!known && most[a] >= least[b] && most[b] >= least[a]) return std::nullopt;
    }
  }
  if (const int kept = old_axis(range); kept >= 0) {
    const auto axis = static_cast<std::size_t>(kept);
    const bool stays = least[axis] * options_->axis_hysteresis >= longest_most;
    const bool goes = most[axis] * options_->axis_hysteresis < longest;
    if (!stays && !goes) return std::nullopt;
  }
  return order_of(range, least);
}

int SplitRule::old_axis(const NodeRange& range) const {
  if (options_->axis_hysteresis <= 1 || options_->previous == nullptr) return -1;
  const Cut* const cut = options_->previous->cut_of(range.first, range.last);
  return cut != nullptr && cut->axes[0] < axes_ ? cut->axes[0] : -1;
}

AxisOrder SplitRule::order_of(const NodeRange& range, const Point& extents) const {
  const AxisOrder order = geometry::order_by_extent(extents, axes_);
  if (band_axis_) return geometry::with_first(order, *band_axis_, axes_);
  const int kept = old_axis(range);
  if (kept >= 0 && extents[static_cast<std::size_t>(kept)] * options_->axis_hysteresis >=
                       extents[static_cast<std::size_t>(order[0])])
    return geometry::with_first(order, kept, axes_);
  return order;
}

}  // namespace rcb::partition
