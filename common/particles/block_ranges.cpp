#include "common/particles/block_ranges.hpp"

// Vectorised by hand: the compiler doesn't vectorise the plain loop.
#if defined(__x86_64__)
#include <immintrin.h>

#include "common/base/cpu.hpp"
#endif

namespace rcb::particles {
namespace {

// A NaN changes neither bound; `known` records it.
Range range_of_each(const double* values, std::size_t count, Range range) {
  bool known = true;
  for (std::size_t i = 0; i < count; ++i) {
    range.lo = values[i] < range.lo ? values[i] : range.lo;
    range.hi = values[i] > range.hi ? values[i] : range.hi;
    known &= values[i] == values[i];
  }
  return known ? range : Range::everything();
}

#if defined(__x86_64__)

[[gnu::target("avx2")]] Range range_of_avx2(const double* values, std::size_t count) {
  constexpr std::size_t kLanes = 4;
  // Two accumulators each, since every minimum depends on the one before it.
  __m256d lo[2] = {_mm256_set1_pd(Range{}.lo), _mm256_set1_pd(Range{}.lo)};
  __m256d hi[2] = {_mm256_set1_pd(Range{}.hi), _mm256_set1_pd(Range{}.hi)};
  __m256d unknown = _mm256_setzero_pd();
  std::size_t i = 0;
  for (; i + 2 * kLanes <= count; i += 2 * kLanes)
    for (std::size_t k = 0; k < 2; ++k) {
      const __m256d x = _mm256_loadu_pd(values + i + k * kLanes);
      lo[k] = _mm256_min_pd(x, lo[k]);
      hi[k] = _mm256_max_pd(x, hi[k]);
      unknown = _mm256_or_pd(unknown, _mm256_cmp_pd(x, x, _CMP_UNORD_Q));
    }
  if (_mm256_movemask_pd(unknown) != 0) return Range::everything();
  alignas(32) double lows[kLanes];
  alignas(32) double highs[kLanes];
  _mm256_store_pd(lows, _mm256_min_pd(lo[0], lo[1]));
  _mm256_store_pd(highs, _mm256_max_pd(hi[0], hi[1]));
  Range range;
  for (std::size_t k = 0; k < kLanes; ++k) range.extend({lows[k], highs[k]});
  return range_of_each(values + i, count - i, range);
}

#endif

}  // namespace

Range range_of(std::span<const double> values) {
#if defined(__x86_64__)
  if (has_avx2()) return range_of_avx2(values.data(), values.size());
#endif
  return range_of_each(values.data(), values.size(), {});
}

}  // namespace rcb::particles
