// The loops over rows that are compiled for each instruction set.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <span>

#include "common/base/wide.hpp"
#include "common/cuts/id_sum.hpp"
#include "common/geometry/box.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::cuts {

inline constexpr std::size_t kBatch = 512;  // rows that are read together: so few that they stay in the nearest cache

// The cuts of a tree's first three levels as a heap: node k has the children 2k + 1 and 2k + 2.
struct TopCuts {
  static constexpr int kLevels = 3;
  std::array<double, 7> value;
  std::array<std::int32_t, 7> at;     // where a batch's coordinates on that axis begin
  std::array<std::int32_t, 8> label;  // of the eight nodes below
};

// The bounds of parts first, first + 1, ... on an axis; lo, hi: [at least 8].
struct AxisBounds {
  const double* lo;
  const double* hi;
  std::size_t parts;
  std::int32_t first;
};

// Of at most kBatch weights, none of them too great for the scale: each as an integer in the scale.
struct ScaledWeights {
  using Halves = std::array<std::uint64_t, kBatch>;
  alignas(64) Halves low;
  alignas(64) Halves high;
  std::uint64_t as_zero;

  u128 operator[](std::size_t i) const { return (u128{high[i]} << 64U) + low[i]; }
  u128 sum(std::size_t count) const {
    std::uint64_t quarter = 0, half = 0, rest = 0;  // a load is below 2^127, so `rest` is whole
    for (std::size_t i = 0; i < count; ++i) {
      quarter += low[i] & 0xFFFFFFFFU;
      half += low[i] >> 32U;
      rest += high[i];
    }
    return (u128{rest} << 64U) + (u128{half} << 32U) + quarter;
  }
};

// Sums such weights of one part three times as fast, where each is 0 or so large that its last bit counts in the scale
// (that is, within 2^55 of the greatest for a million particles). Each is split into three doubles of so few bits that
// 512 of them are added without rounding: ExtractVector of Rump, Ogita, Oishi 2008, doi:10.1137/050645671.
struct QuickSum {
  double upper = 0, middle = 0, lower = 0;
  bool small = false;  // there is one that is rounded in the scale, and the sum is of no use

  static constexpr std::size_t kLanesMost = 8;     // it takes multiples of them
  static constexpr int kMiddle = 35, kUpper = 75;  // binades above the last place of the scale where the splits are
  static constexpr int kScaleLeast = -890;         // so that no sum overflows

  u128 value(int scale) const {
    const auto whole = [scale](double sum, int place) {
      return static_cast<u128>(static_cast<std::int64_t>(std::ldexp(sum, scale - place)))
             << static_cast<unsigned>(place);
    };
    return whole(upper, kUpper) + whole(middle, kMiddle) + whole(lower, 0);  // mod 2^128: some are negative
  }
};

// Where bits are told, there is one for each of at most 64 rows that is not strictly inside. NaN and infinity never
// are.
struct Kernels {
  // Sets out[i] to the label of the node that row i reaches, and tied[i] to 1 where it may lie on a cut's plane. x: a
  // batch. Returns for how many rows: not for a few last ones, or for none.
  std::size_t (*descend)(const TopCuts& top, const double* x, std::size_t count, std::int32_t* out, std::uint8_t* tied);
  std::uint64_t (*outside_own)(std::span<const double> x, const std::int32_t* part, const AxisBounds& bounds);
  std::uint64_t (*outside)(const particles::Axes& x, std::size_t count, const geometry::Box& box);
  // The same for rows of three coordinates that follow one another.
  template <typename T>
  struct Rows {
    bool (*all_inside)(const T* rows, std::size_t count, const geometry::Box& box);
    std::uint64_t (*outside_own)(const T* rows, std::size_t count, const geometry::Box* boxes,
                                 const std::int32_t* part);
  };
  Rows<double> rows;
  Rows<float> rows_f4;
  // As ExactScale does.
  void (*scale)(const double* weight, std::size_t count, std::int64_t scale, ScaledWeights& to);
  QuickSum (*sum)(const double* weight, std::size_t count, int scale);
  IdSums (*sum_ids)(std::span<const particles::Id> ids, std::uint64_t key);
};

// Those for the instruction set that is to be used.
const Kernels& kernels();

}  // namespace rcb::cuts
