// Loads four particles from three coordinate arrays as four vectors, each with all axes of one particle: for passes
// that do the same on each axis. x86-64 with AVX2 only: callers are compiled for it and check the CPU first.
#pragma once

#if defined(__x86_64__)
#include <array>
#include <cstddef>

#include <immintrin.h>

#include "common/geometry/axes.hpp"

namespace rcb::partition {

// point[k]: the coordinates of particle i + k; the fourth lane repeats the third axis.
[[gnu::target("avx2"), gnu::always_inline]] inline void load_four_points(
    const std::array<const double*, geometry::kDimsMax>& x, std::size_t i, __m256d (&point)[4]) {
  const __m256d x0 = _mm256_loadu_pd(x[0] + i);
  const __m256d x1 = _mm256_loadu_pd(x[1] + i);
  const __m256d x2 = _mm256_loadu_pd(x[2] + i);
  // even: particles 0 and 2; odd: 1 and 3.
  const __m256d even = _mm256_unpacklo_pd(x0, x1);
  const __m256d odd = _mm256_unpackhi_pd(x0, x1);
  const __m256d even_rest = _mm256_unpacklo_pd(x2, x2);
  const __m256d odd_rest = _mm256_unpackhi_pd(x2, x2);
  point[0] = _mm256_permute2f128_pd(even, even_rest, 0x20);
  point[1] = _mm256_permute2f128_pd(odd, odd_rest, 0x20);
  point[2] = _mm256_permute2f128_pd(even, even_rest, 0x31);
  point[3] = _mm256_permute2f128_pd(odd, odd_rest, 0x31);
}

}  // namespace rcb::partition
#endif
