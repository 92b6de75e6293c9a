// Axes, their order by extent, and the order-preserving integer image of a double.
//
// Invariants
// 1. image(a) < image(b) exactly where a < b; image(-0.0) == image(0.0); NaN and infinity never come here.
// 2. An axis order is a permutation of 0..dims-1, longest extent first, equal extents by axis number.
#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <utility>

namespace rcb::geometry {

inline constexpr int kDimsMax = 3;

using Point = std::array<double, kDimsMax>;           // the first `dims` entries count
using AxisOrder = std::array<std::int8_t, kDimsMax>;  // the first `dims` entries count

// The image of a finite double: compares as the double does, as an unsigned integer.
constexpr std::uint64_t image(double value) {
  const auto bits = std::bit_cast<std::uint64_t>(value + 0.0);  // -0.0 + 0.0 == 0.0
  const auto sign = static_cast<std::uint64_t>(static_cast<std::int64_t>(bits) >> 63);
  return bits ^ (sign | 0x8000000000000000U);
}

// The double of that image; 0.0 for both zeros.
constexpr double value_of_image(std::uint64_t key) {
  const std::uint64_t sign = (key >> 63U) - 1U;  // all ones for negative doubles
  return std::bit_cast<double>(key ^ (sign | 0x8000000000000000U));
}

// Length of [lo, hi] halved, so that it can't overflow: each half is rounded to double first.
constexpr double extent(double lo, double hi) { return hi * 0.5 - lo * 0.5; }

// The axes by extent, longest first; equal extents: the lower axis first.
constexpr AxisOrder order_by_extent(const Point& extents, int dims) {
  AxisOrder order{0, 1, 2};
  for (int i = 1; i < dims; ++i)
    for (int j = i; j > 0; --j) {
      auto& left = order[static_cast<std::size_t>(j - 1)];
      auto& right = order[static_cast<std::size_t>(j)];
      if (!(extents[static_cast<std::size_t>(right)] > extents[static_cast<std::size_t>(left)])) break;
      std::swap(left, right);
    }
  return order;
}

// The same order with `first` moved to the front.
constexpr AxisOrder with_first(AxisOrder order, int first, int dims) {
  int at = 0;
  while (at < dims && order[static_cast<std::size_t>(at)] != first) ++at;
  for (; at > 0; --at) order[static_cast<std::size_t>(at)] = order[static_cast<std::size_t>(at - 1)];
  order[0] = static_cast<std::int8_t>(first);
  return order;
}

}  // namespace rcb::geometry
