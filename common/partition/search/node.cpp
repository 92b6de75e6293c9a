#include "common/partition/search/node.hpp"

#include <algorithm>
#include <limits>
#include <numeric>

namespace rcb::partition {

geometry::Box box_of(std::span<const Bucket> buckets, std::span<const std::int32_t> some) {
  geometry::Box box;
  for (const std::int32_t b : some) box.extend(buckets[at(b)].box);
  return box;
}

Load load_of(std::span<const Bucket> buckets, std::span<const std::int32_t> some) {
  Load load;
  for (const std::int32_t b : some) load += buckets[at(b)].load;
  return load;
}

Interval Wholes::interval_of(std::int32_t bucket) const {
  const auto axis = at(node_.axes[0]);
  const QBounds& q = buckets_[at(bucket)].q;
  return {q.lo[axis], q.hi[axis]};
}

bool Wholes::meets(const Interval& interval) const {
  return std::ranges::any_of(node_.wholes, [&](std::int32_t b) { return interval.meets(interval_of(b)); });
}

std::vector<std::int32_t> Wholes::in(const Interval& region) const {
  std::vector<std::int32_t> found;
  for (const std::int32_t b : node_.wholes)
    if (interval_of(b).lo >= region.lo && interval_of(b).hi <= region.hi) found.push_back(b);
  return found;
}

Load Wholes::load_in(const Interval& region) const { return load_of(buckets_, in(region)); }

std::int32_t Wholes::first_above(std::int32_t integer) const {
  std::int32_t first = AxisMap::kTop;
  for (const std::int32_t b : node_.wholes)
    if (interval_of(b).lo > integer) first = std::min(first, interval_of(b).lo);
  return first;
}

// If cuts above lie across other axes than expected, the wholes were meant for other parts than the node's: then the
// middle of those parts divides them.
Interval Wholes::gap() const {
  NodeRange meant{.first = std::numeric_limits<int>::max(), .last = 0};
  for (const std::int32_t b : node_.wholes) {
    meant.first = std::min(meant.first, buckets_[at(b)].first);
    meant.last = std::max(meant.last, buckets_[at(b)].last);
  }
  const bool as_expected = meant.first >= node_.range.first && meant.last <= node_.range.last;
  const int middle = (as_expected ? node_.range : meant).middle();
  Interval gap = Interval::everything();
  for (const std::int32_t b : node_.wholes) {
    if (buckets_[at(b)].last <= middle) gap.lo = std::max(gap.lo, interval_of(b).hi + 1);
    if (buckets_[at(b)].first >= middle) gap.hi = std::min(gap.hi, interval_of(b).lo - 1);
  }
  return gap;
}

Interval Wholes::likely(u128 wanted) const {
  const auto middle_of = [this](std::int32_t b) { return std::midpoint(interval_of(b).lo, interval_of(b).hi); };
  std::vector<std::int32_t> wholes = node_.wholes;
  std::ranges::sort(wholes, {}, middle_of);
  u128 before = (weighted_ ? node_.points.load.weight : u128{node_.points.load.count}) / 2;
  const auto reached = std::ranges::find_if(wholes, [&](std::int32_t b) { return (before += load(b)) >= wanted; });
  const std::int32_t key = middle_of(reached == wholes.end() ? wholes.back() : *reached);
  Interval likely = Interval::everything();
  for (const std::int32_t b : wholes) {
    if (interval_of(b).hi < key) likely.lo = std::max(likely.lo, interval_of(b).hi + 1);
    if (interval_of(b).lo > key) likely.hi = std::min(likely.hi, interval_of(b).lo - 1);
  }
  return likely;
}

Interval Wholes::certain(const Interval& region, u128 loose, u128 wanted) const {
  // The first of these ends up to which, with what lies there at least or at most, there is enough.
  const auto reached = [&](std::int32_t Interval::*end, u128 before) {
    std::vector<std::int32_t> wholes = in(region);
    std::ranges::sort(wholes, {}, [&](std::int32_t b) { return interval_of(b).*end; });
    for (const std::int32_t b : wholes)
      if ((before += load(b)) >= wanted) return interval_of(b).*end;
    return region.hi;
  };
  return {loose >= wanted ? region.lo : reached(&Interval::lo, loose), reached(&Interval::hi, 0)};
}

}  // namespace rcb::partition
