// Sums of 128-bit integers over ranks, built on Comm's 64-bit sums.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "common/base/wide.hpp"
#include "common/comm/comm.hpp"

namespace rcb::comm {

// A value < 2^128 as three limbs of 43, 43 and 42 bits: the sum of a limb over up to 2^21 ranks fits in 64 bits.
inline constexpr unsigned kLimbBits = 43;
inline constexpr std::size_t kLimbs = 3;

constexpr std::array<std::uint64_t, kLimbs> limbs_of(u128 value) {
  constexpr u128 mask = (u128{1} << kLimbBits) - 1;
  return {static_cast<std::uint64_t>(value & mask), static_cast<std::uint64_t>((value >> kLimbBits) & mask),
          static_cast<std::uint64_t>(value >> (2 * kLimbBits))};
}
constexpr u128 value_of_limbs(std::span<const std::uint64_t, kLimbs> limbs) {
  return u128{limbs[0]} + (u128{limbs[1]} << kLimbBits) + (u128{limbs[2]} << (2 * kLimbBits));
}

// values[i] becomes the sum of all ranks' values[i], which must stay below 2^128. Collective (one reduction).
void all_sum_wide(Comm& comm, std::span<u128> values);

}  // namespace rcb::comm
