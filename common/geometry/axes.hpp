// Axes, their order by extent, and the order-preserving integer bits of a double.
//
// Invariants
// 1. order_bits(a) < order_bits(b) exactly if a < b; order_bits(-0.0) == order_bits(0.0). NaN is never passed.
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

// The order-preserving bits of a double: as unsigned integers they compare as the doubles do.
constexpr std::uint64_t order_bits(double value) {
  const auto bits = std::bit_cast<std::uint64_t>(value + 0.0);  // -0.0 + 0.0 == 0.0
  const auto sign = static_cast<std::uint64_t>(static_cast<std::int64_t>(bits) >> 63);
  return bits ^ (sign | 0x8000000000000000U);
}

// Likewise of a float.
constexpr std::uint32_t order_bits(float value) {
  const auto bits = std::bit_cast<std::uint32_t>(value + 0.0F);
  const auto sign = static_cast<std::uint32_t>(static_cast<std::int32_t>(bits) >> 31);
  return bits ^ (sign | 0x80000000U);
}

// The inverse of order_bits(); both zeros come back as 0.0.
constexpr double value_of_order_bits(std::uint64_t key) {
  const std::uint64_t sign = (key >> 63U) - 1U;  // all ones for negative doubles
  return std::bit_cast<double>(key ^ (sign | 0x8000000000000000U));
}

// Half the length of [lo, hi], which can't overflow; each half is rounded to double before the subtraction.
constexpr double extent(double lo, double hi) { return hi * 0.5 - lo * 0.5; }

// The axes by extent, longest first; of equal extents the lower axis comes first.
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

// The same axis order with `first` moved to the front.
constexpr AxisOrder with_first(AxisOrder order, int first, int dims) {
  int at = 0;
  while (at < dims && order[static_cast<std::size_t>(at)] != first) ++at;
  for (; at > 0; --at) order[static_cast<std::size_t>(at)] = order[static_cast<std::size_t>(at - 1)];
  order[0] = static_cast<std::int8_t>(first);
  return order;
}

}  // namespace rcb::geometry
