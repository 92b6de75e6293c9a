// Whether all of some coordinates lie strictly between two bounds; NaN and infinity never do.
#pragma once

#include <cstddef>
#if defined(__SSE2__)
#include <emmintrin.h>
#endif

namespace rcb::service {

inline bool all_inside(const double* values, std::size_t count, double lo, double hi) {
  std::size_t i = 0;
  bool inside = true;
#if defined(__SSE2__)
  // By hand: without SSE4 the compiler makes single steps of it, at four times the time.
  const __m128d low = _mm_set1_pd(lo);
  const __m128d high = _mm_set1_pd(hi);
  __m128d outside = _mm_setzero_pd();
  for (; i + 4 <= count; i += 4) {
    const __m128d a = _mm_loadu_pd(values + i);
    const __m128d b = _mm_loadu_pd(values + i + 2);
    outside = _mm_or_pd(outside, _mm_or_pd(_mm_cmpngt_pd(a, low), _mm_cmpnlt_pd(a, high)));
    outside = _mm_or_pd(outside, _mm_or_pd(_mm_cmpngt_pd(b, low), _mm_cmpnlt_pd(b, high)));
  }
  inside = _mm_movemask_pd(outside) == 0;
#endif
  for (; i < count; ++i) inside &= (values[i] > lo) & (values[i] < hi);
  return inside;
}

}  // namespace rcb::service
