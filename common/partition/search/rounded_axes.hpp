// RoundedAxes: coordinates rounded to float, of which a pass over all particles compares eight or sixteen at once.
// Rounding keeps the order: of two coordinates, the lesser one is never the greater float.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "common/base/cpu.hpp"
#include "common/geometry/box.hpp"

namespace rcb::partition {

struct RoundedAxes {
  geometry::Point origin{};
  geometry::Point scale{1, 1, 1};

  // Makes floats tell these coordinates apart as well as they can: they are densest at 0.
  void fit(std::size_t axis, std::span<const double> x) {
    double lo = std::numeric_limits<double>::infinity();
    double hi = -lo;
    geometry::least_and_most(x, lo, hi);
    if (lo > hi) return;
    origin[axis] = std::clamp(0.0, lo, hi);
    const double reach = std::max(hi * 0.5 - origin[axis] * 0.5, origin[axis] * 0.5 - lo * 0.5);
    const double factor = std::isnormal(reach) ? std::ldexp(1.0, -std::ilogb(reach)) : 1.0;
    if (std::isnormal(factor)) scale[axis] = factor;
  }
  float operator()(std::size_t axis, double x) const { return static_cast<float>((x - origin[axis]) * scale[axis]); }
};

#if defined(__x86_64__)
// Eight of an axis' coordinates.
[[gnu::target(RCB_AVX2), gnu::always_inline]] inline __m256 rounded8(const RoundedAxes& axes, std::size_t axis,
                                                                     const double* x) {
  const __m256d origin = _mm256_set1_pd(axes.origin[axis]);
  const __m256d scale = _mm256_set1_pd(axes.scale[axis]);
  return _mm256_set_m128(_mm256_cvtpd_ps(_mm256_mul_pd(_mm256_sub_pd(_mm256_loadu_pd(x + 4), origin), scale)),
                         _mm256_cvtpd_ps(_mm256_mul_pd(_mm256_sub_pd(_mm256_loadu_pd(x), origin), scale)));
}
// Sixteen.
[[gnu::target(RCB_AVX512), gnu::always_inline]] inline __m512 rounded16(const RoundedAxes& axes, std::size_t axis,
                                                                        const double* x) {
  const __m512d origin = _mm512_set1_pd(axes.origin[axis]);
  const __m512d scale = _mm512_set1_pd(axes.scale[axis]);
  const __m256 low = _mm512_cvtpd_ps(_mm512_mul_pd(_mm512_sub_pd(_mm512_loadu_pd(x), origin), scale));
  const __m256 high = _mm512_cvtpd_ps(_mm512_mul_pd(_mm512_sub_pd(_mm512_loadu_pd(x + 8), origin), scale));
  return _mm512_insertf32x8(_mm512_castps256_ps512(low), high, 1);
}
#endif

}  // namespace rcb::partition
