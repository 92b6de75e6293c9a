#include "common/partition/sample/sorted_sample.hpp"

#include <algorithm>
#include <numeric>
#include <span>

namespace rcb::partition {

using geometry::Point;

SortedSample::SortedSample(const Sample& sample) : sample_(&sample), side_(sample.count()), right_(sample.count()) {
  for (std::size_t a = 0; a < at(sample.dims) && sample.count() > 0; ++a) sort(a);
}

void SortedSample::set_outermost(const Sample& outermost) {
  outermost_.assign(outermost.count(), {});
  for (std::size_t k = 0; k < outermost.count(); ++k)
    for (std::size_t a = 0; a < at(outermost.dims); ++a) outermost_[k][a] = outermost.x(a, k);
}

// By radix, in three digits: the order-preserving bits of the floats, each with the particle's index behind it. Then
// those few that share a float are sorted by their doubles.
void SortedSample::sort(std::size_t axis) {
  constexpr unsigned kIndexBits = 32;
  constexpr unsigned kDigitBits = 11;
  constexpr std::size_t kDigits = std::size_t{1} << kDigitBits;
  const std::span<const double> x = sample_->position[axis].span();
  rounded_.fit(axis, x);
  Buffer<std::uint64_t> keys(x.size());
  Buffer<std::uint64_t> sorted(x.size());
  std::array<std::array<std::uint32_t, kDigits + 1>, 3> begins{};
  for (std::size_t k = 0; k < x.size(); ++k) {
    const std::uint32_t bits = geometry::order_bits(rounded_(axis, x[k]));
    keys[k] = std::uint64_t{bits} << kIndexBits | k;
    for (std::size_t digit = 0; digit < begins.size(); ++digit)
      ++begins[digit][(bits >> (digit * kDigitBits)) % kDigits + 1];
  }
  for (std::size_t digit = 0; digit < begins.size(); ++digit) {
    auto& begin = begins[digit];
    std::partial_sum(begin.begin(), begin.end(), begin.begin());
    for (const std::uint64_t key : keys) sorted[begin[(key >> (kIndexBits + digit * kDigitBits)) % kDigits]++] = key;
    std::swap(keys, sorted);
  }
  order_[axis].resize(x.size());
  for (std::size_t k = 0; k < x.size(); ++k) order_[axis][k] = static_cast<std::uint32_t>(keys[k]);
  const auto coordinate = [x](std::uint32_t k) { return x[k]; };
  for (std::size_t first = 0, last = 0; first < x.size(); first = last) {
    while (last < x.size() && keys[last] >> kIndexBits == keys[first] >> kIndexBits) ++last;
    const auto tied = std::span(order_[axis]).subspan(first, last - first);
    if (!std::ranges::is_sorted(tied, {}, coordinate)) std::ranges::sort(tied, {}, coordinate);
  }
}

geometry::Box SortedSample::box(const Range& range) const {
  geometry::Box box;
  for (std::size_t a = 0; a < at(sample_->dims) && range.size() > 0; ++a) {
    box.lo[a] = x(range, a, 0);
    box.hi[a] = x(range, a, range.size() - 1);
  }
  for (std::size_t k = range.outermost_first; k < range.outermost_last; ++k) box.extend(outermost_[k], sample_->dims);
  return box;
}

Point SortedSample::extents(const Range& range) const {
  const geometry::Box own = box(range);
  Point extents{};
  for (std::size_t a = 0; a < at(sample_->dims) && range.size() > 0; ++a)
    extents[a] = std::max(geometry::extent(own.lo[a], own.hi[a]), 0.0);
  return extents;
}

std::size_t SortedSample::below(const Range& range, std::size_t axis, double x) const {
  const auto coordinate = [&](std::uint32_t k) { return sample_->x(axis, k); };
  const auto own = std::span(order_[axis]).subspan(range.first, range.size());
  return static_cast<std::size_t>(std::ranges::lower_bound(own, x, {}, coordinate) - own.begin());
}

SortedSample::Halves SortedSample::split(const Range& range, std::size_t axis, std::size_t left) {
  for (std::size_t k = range.first; k < range.last; ++k) side_[order_[axis][k]] = k < range.first + left ? 0 : 1;
  for (std::size_t a = 0; a < at(sample_->dims); ++a) {
    if (a == axis) continue;
    // Without branches, which would often be mispredicted.
    std::uint32_t* const own = order_[a].data() + range.first;
    std::size_t lefts = 0;
    for (std::size_t i = 0; i < range.size(); ++i) {
      const std::uint32_t k = own[i];
      own[lefts] = k;
      right_[i - lefts] = k;
      lefts += side_[k] == 0 ? 1U : 0U;
    }
    std::copy_n(right_.begin(), range.size() - lefts, own + lefts);
  }
  const double cut = left < range.size() ? x(range, axis, left) : geometry::Box::kInfinity;
  const auto own = std::span(outermost_).subspan(range.outermost_first, range.outermost_last - range.outermost_first);
  const auto right = std::ranges::partition(own, [&](const Point& position) { return position[axis] < cut; });
  const std::size_t middle = range.first + left;
  const std::size_t outermost_middle = range.outermost_last - right.size();
  return {{range.first, middle, range.outermost_first, outermost_middle},
          {middle, range.last, outermost_middle, range.outermost_last}};
}

}  // namespace rcb::partition
