// ExactScale: sums of doubles that are the same in any order.
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>

#include "common/base/check.hpp"
#include "common/base/wide.hpp"

namespace rcb {

// Turns non-negative finite doubles into integers by one power-of-two scale for all: value * 2^scale, rounded down. The
// scale is chosen so that the sum of `count` values fits in 127 bits. A value loses less than 2^-(125 - log2(count)) of
// the largest one, and nothing while largest / smallest spans fewer than 73 - log2(count) binades (a double has 53
// bits).
class ExactScale {
 public:
  // largest: the greatest value, > 0; count: how many values are summed, >= 1.
  ExactScale(double largest, std::uint64_t count) {
    RCB_CHECK(largest > 0 && std::isfinite(largest) && count >= 1, "a positive largest value");
    int above = 0;
    std::frexp(largest, &above);                                            // largest < 2^above
    exponent_ = 127 - above - static_cast<int>(std::bit_width(count - 1));  // count <= 2^bit_width(count - 1)
  }
  explicit ExactScale(int exponent) : exponent_(exponent) {}

  u128 operator()(double value) const {
    const auto bits = std::bit_cast<std::uint64_t>(value);
    const auto biased = static_cast<int>((bits >> 52U) & 0x7FFU);
    const std::uint64_t fraction = bits & 0xFFFFFFFFFFFFFU;
    const std::uint64_t significand = biased == 0 ? fraction : fraction | (std::uint64_t{1} << 52U);
    const int shift = std::max(biased, 1) - 1075 + exponent_;
    if (shift <= -64) return 0;
    if (shift < 0) return significand >> static_cast<unsigned>(-shift);
    if (significand == 0) return 0;
    RCB_CHECK(static_cast<int>(std::bit_width(significand)) + shift <= 127, "a value beyond the largest");
    return u128{significand} << static_cast<unsigned>(shift);
  }
  int exponent() const { return exponent_; }

 private:
  int exponent_ = 0;
};

}  // namespace rcb
