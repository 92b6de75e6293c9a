#include "common/cuts/regions.hpp"

#include <algorithm>

#if defined(__x86_64__)
#include <immintrin.h>

#include "common/base/cpu.hpp"
#endif

namespace rcb::cuts {
namespace {

constexpr std::size_t kLanes = 4;
constexpr std::size_t kInRegisters = 2 * kLanes;  // most parts whose bounds on an axis fit in registers

std::uint64_t outside_each(std::span<const double> x, const std::int32_t* part, std::int32_t first, const double* lo,
                           const double* hi, std::size_t from) {
  std::uint64_t outside = 0;
  for (std::size_t i = from; i < x.size(); ++i) {
    const auto p = static_cast<std::size_t>(part[i] - first);
    outside |= static_cast<std::uint64_t>(!((x[i] > lo[p]) & (x[i] < hi[p]))) << i;
  }
  return outside;
}

std::uint64_t outside_box(const particles::Axes& x, std::size_t from, std::size_t count, const geometry::Box& box) {
  std::uint64_t outside = 0;
  for (std::size_t i = from; i < count; ++i) {
    bool inside = true;
    for (std::size_t a = 0; a < x.size(); ++a) inside = inside & (x[a][i] > box.lo[a]) & (x[a][i] < box.hi[a]);
    outside |= static_cast<std::uint64_t>(!inside) << i;
  }
  return outside;
}

#if defined(__x86_64__)

// Takes the bounds of each particle's part from registers, by a permutation, instead of loading them one by one. kMany:
// there are more than kLanes parts.
template <bool kMany>
[[gnu::target("avx2")]] std::uint64_t outside_avx2(std::span<const double> x, const std::int32_t* part,
                                                   std::int32_t first, const double* lo, const double* hi) {
  const __m256i lo_a = _mm256_castpd_si256(_mm256_loadu_pd(lo));
  const __m256i hi_a = _mm256_castpd_si256(_mm256_loadu_pd(hi));
  const __m256i lo_b = _mm256_castpd_si256(_mm256_loadu_pd(lo + kLanes));
  const __m256i hi_b = _mm256_castpd_si256(_mm256_loadu_pd(hi + kLanes));
  const __m128i first_part = _mm_set1_epi32(first);
  const __m256i second_half = _mm256_set1_epi64x(std::int64_t{1} << 32U);
  std::uint64_t outside = 0;
  std::size_t i = 0;
  for (; i + kLanes <= x.size(); i += kLanes) {
    const __m128i at = _mm_sub_epi32(_mm_loadu_si128(reinterpret_cast<const __m128i*>(part + i)), first_part);
    const __m256i p = _mm256_cvtepu32_epi64(at);
    // Double p is the pair of 32-bit lanes 2p and 2p + 1 of a register.
    const __m256i twice = _mm256_slli_epi64(p, 1);
    const __m256i halves = _mm256_or_si256(_mm256_or_si256(twice, _mm256_slli_epi64(twice, 32)), second_half);
    __m256d low = _mm256_castsi256_pd(_mm256_permutevar8x32_epi32(lo_a, halves));
    __m256d high = _mm256_castsi256_pd(_mm256_permutevar8x32_epi32(hi_a, halves));
    if constexpr (kMany) {
      const __m256d is_b = _mm256_castsi256_pd(_mm256_slli_epi64(p, 61));  // moves the bit for 4 to the sign bit
      low = _mm256_blendv_pd(low, _mm256_castsi256_pd(_mm256_permutevar8x32_epi32(lo_b, halves)), is_b);
      high = _mm256_blendv_pd(high, _mm256_castsi256_pd(_mm256_permutevar8x32_epi32(hi_b, halves)), is_b);
    }
    const __m256d value = _mm256_loadu_pd(x.data() + i);
    const __m256d beyond =
        _mm256_or_pd(_mm256_cmp_pd(value, low, _CMP_NGT_UQ), _mm256_cmp_pd(value, high, _CMP_NLT_UQ));
    outside |= static_cast<std::uint64_t>(_mm256_movemask_pd(beyond)) << i;
  }
  return outside | outside_each(x, part, first, lo, hi, i);
}

[[gnu::target("avx2")]] std::uint64_t outside_box_avx2(const particles::Axes& x, std::size_t count,
                                                       const geometry::Box& box) {
  __m256d low[geometry::kDimsMax];
  __m256d high[geometry::kDimsMax];
  for (std::size_t a = 0; a < x.size(); ++a) {
    low[a] = _mm256_set1_pd(box.lo[a]);
    high[a] = _mm256_set1_pd(box.hi[a]);
  }
  std::uint64_t outside = 0;
  std::size_t i = 0;
  for (; i + kLanes <= count; i += kLanes) {
    __m256d beyond = _mm256_setzero_pd();
    for (std::size_t a = 0; a < x.size(); ++a) {
      const __m256d value = _mm256_loadu_pd(x[a] + i);
      beyond = _mm256_or_pd(
          beyond, _mm256_or_pd(_mm256_cmp_pd(value, low[a], _CMP_NGT_UQ), _mm256_cmp_pd(value, high[a], _CMP_NLT_UQ)));
    }
    outside |= static_cast<std::uint64_t>(_mm256_movemask_pd(beyond)) << i;
  }
  return outside | outside_box(x, i, count, box);
}

#endif

}  // namespace

std::uint64_t outside_of(const particles::Axes& x, std::size_t count, const geometry::Box& box) {
#if defined(__x86_64__)
  if (has_avx2()) return outside_box_avx2(x, count, box);
#endif
  return outside_box(x, 0, count, box);
}

Regions::Regions(std::int32_t first_part, std::span<const geometry::Box> boxes)
    : first_part_(first_part), parts_(boxes.size()) {
  for (std::size_t a = 0; a < geometry::kDimsMax; ++a) {
    lo_[a].assign(std::max(parts_, kInRegisters), 0);
    hi_[a].assign(std::max(parts_, kInRegisters), 0);
    for (std::size_t p = 0; p < parts_; ++p) {
      lo_[a][p] = boxes[p].lo[a];
      hi_[a][p] = boxes[p].hi[a];
    }
  }
}

std::uint64_t Regions::outside(std::size_t axis, std::span<const double> values, const std::int32_t* part) const {
  const double* const lo = lo_[axis].data();
  const double* const hi = hi_[axis].data();
#if defined(__x86_64__)
  if (has_avx2() && parts_ <= kInRegisters)
    return (parts_ <= kLanes ? outside_avx2<false> : outside_avx2<true>)(values, part, first_part_, lo, hi);
#endif
  return outside_each(values, part, first_part_, lo, hi, 0);
}

}  // namespace rcb::cuts
