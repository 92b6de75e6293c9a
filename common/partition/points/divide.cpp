#include "common/partition/points/divide.hpp"

#include <algorithm>
#include <array>
#include <utility>

namespace rcb::partition {
namespace {

// A quantised point as one vector: moved by one load and one store.
using PointLanes = std::int32_t __attribute__((vector_size(sizeof(QuantisedPoint)), may_alias));

// Calls move() with every point that is `wanted`, those of a block at a time, which are listed first: few points are
// wanted, and a branch on each would often be mispredicted.
template <typename Iterator, typename Wanted, typename Move>
void for_the_few(Iterator points, std::size_t size, const Wanted& wanted, const Move& move) {
  constexpr std::size_t kTogether = 512;
  std::array<std::uint32_t, kTogether> found;
  for (std::size_t begin = 0; begin < size; begin += kTogether) {
    const auto block = points + static_cast<std::ptrdiff_t>(begin);
    const auto most = static_cast<std::uint32_t>(std::min(kTogether, size - begin));
    std::size_t count = 0;
    for (std::uint32_t k = 0; k < most; ++k) {
      found[count] = k;
      count += wanted(block[k]) ? 1U : 0U;
    }
    for (std::size_t k = 0; k < count; ++k) move(block[found[k]]);
  }
}

}  // namespace

// Points at either end that are on the right side already are skipped, since solvers' orders are seldom random. All
// others are swapped without a branch, which would often be mispredicted. Four at a time: the time of a shorter loop
// depends on where the linker puts it (by up to 40 % on Zen 5).
QuantisedPoint* divide(std::span<QuantisedPoint> points, std::size_t axis, std::int32_t first_right) {
  while (!points.empty() && points.front().q[axis] < first_right) points = points.subspan(1);
  while (!points.empty() && points.back().q[axis] >= first_right) points = points.first(points.size() - 1);
  QuantisedPoint* left_end = points.data();
  const auto swap = [&](QuantisedPoint& point) {
    PointLanes& own = reinterpret_cast<PointLanes&>(point);
    PointLanes& other = reinterpret_cast<PointLanes&>(*left_end);
    const PointLanes moved = own;
    left_end += static_cast<std::ptrdiff_t>(point.q[axis] < first_right);
    own = other;
    other = moved;
  };
  std::size_t i = 0;
  for (; i + 4 <= points.size(); i += 4)
    for (std::size_t k = 0; k < 4; ++k) swap(points[i + k]);
  for (; i < points.size(); ++i) swap(points[i]);
  return left_end;
}

QuantisedPoint* divide_few(std::span<QuantisedPoint> points, std::size_t axis, std::int32_t first_right) {
  QuantisedPoint* next = points.data();
  for_the_few(
      points.begin(), points.size(), [=](const QuantisedPoint& point) { return point.q[axis] < first_right; },
      [&](QuantisedPoint& point) { std::swap(point, *next++); });
  return next;
}

QuantisedPoint* divide_few_right(std::span<QuantisedPoint> points, std::size_t axis, std::int32_t first_right) {
  QuantisedPoint* end = points.data() + points.size();
  for_the_few(
      points.rbegin(), points.size(), [=](const QuantisedPoint& point) { return point.q[axis] >= first_right; },
      [&](QuantisedPoint& point) { std::swap(point, *--end); });
  return end;
}

void count_bins(std::span<const QuantisedPoint> points, std::size_t axis, std::int32_t lo, unsigned shift,
                std::span<std::uint32_t> even, std::span<std::uint32_t> odd) {
  const auto bin = [&](std::size_t i) { return static_cast<std::uint32_t>(points[i].q[axis] - lo) >> shift; };
  std::size_t i = 0;
  for (; i + 2 <= points.size(); i += 2) {
    ++even[bin(i)];
    ++odd[bin(i + 1)];
  }
  if (i < points.size()) ++even[bin(i)];
}

}  // namespace rcb::partition
