#include "server/service/inside.hpp"

// By hand: of the plain loop the compiler makes single steps, at four times the time of SSE2, eight times that of AVX2.
#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace rcb::service {
namespace {

bool inside_each(const double* values, std::size_t count, double lo, double hi) {
  bool inside = true;
  for (std::size_t i = 0; i < count; ++i) inside &= (values[i] > lo) & (values[i] < hi);
  return inside;
}

#if defined(__x86_64__)

bool inside_sse2(const double* values, std::size_t count, double lo, double hi) {
  const __m128d low = _mm_set1_pd(lo);
  const __m128d high = _mm_set1_pd(hi);
  __m128d outside = _mm_setzero_pd();
  std::size_t i = 0;
  for (; i + 2 <= count; i += 2) {
    const __m128d x = _mm_loadu_pd(values + i);
    outside = _mm_or_pd(outside, _mm_or_pd(_mm_cmpngt_pd(x, low), _mm_cmpnlt_pd(x, high)));
  }
  return _mm_movemask_pd(outside) == 0 && inside_each(values + i, count - i, lo, hi);
}

[[gnu::target("avx2")]] bool inside_avx2(const double* values, std::size_t count, double lo, double hi) {
  const __m256d low = _mm256_set1_pd(lo);
  const __m256d high = _mm256_set1_pd(hi);
  __m256d outside = _mm256_setzero_pd();
  std::size_t i = 0;
  for (; i + 4 <= count; i += 4) {
    const __m256d x = _mm256_loadu_pd(values + i);
    const __m256d below = _mm256_cmp_pd(x, low, _CMP_NGT_UQ);
    const __m256d above = _mm256_cmp_pd(x, high, _CMP_NLT_UQ);
    outside = _mm256_or_pd(outside, _mm256_or_pd(below, above));
  }
  return _mm256_movemask_pd(outside) == 0 && inside_each(values + i, count - i, lo, hi);
}

#endif

}  // namespace

bool all_inside(const double* values, std::size_t count, double lo, double hi) {
#if defined(__x86_64__)
  static const bool avx2 = __builtin_cpu_supports("avx2") != 0;
  return (avx2 ? inside_avx2 : inside_sse2)(values, count, lo, hi);
#else
  return inside_each(values, count, lo, hi);
#endif
}

}  // namespace rcb::service
