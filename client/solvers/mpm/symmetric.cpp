#include "client/solvers/mpm/symmetric.hpp"

namespace rcb::solvers {
namespace {

constexpr double kLogSeries = 0.15;  // the series is used up to this norm of m - I
constexpr double kExpSeries = 0.06;  // the series is used up to this norm of m
constexpr int kSweepsMax = 30;       // four are typical

template <class Function>
Sym3 by_axes(const Sym3& m, Function&& function) {
  const auto [values, axes] = principal(m);
  Sym3 sum;
  for (std::size_t k = 0; k < 3; ++k) {
    const double f = function(values[k]);
    const double x = axes(0, k);
    const double y = axes(1, k);
    const double z = axes(2, k);
    sum.xx += f * x * x;
    sum.yy += f * y * y;
    sum.zz += f * z * z;
    sum.xy += f * x * y;
    sum.xz += f * x * z;
    sum.yz += f * y * z;
  }
  return sum;
}

Sym3 inverse(const Sym3& m) {
  const double by = 1 / determinant(m);
  return by * Sym3{m.yy * m.zz - m.yz * m.yz, m.xx * m.zz - m.xz * m.xz, m.xx * m.yy - m.xy * m.xy,
                   m.xz * m.yz - m.xy * m.zz, m.xy * m.yz - m.xz * m.yy, m.xy * m.xz - m.xx * m.yz};
}

}  // namespace

Principal principal(const Sym3& m) {
  Mat3 a = m.full();
  Principal result;
  result.axes = Mat3::identity();
  Mat3& v = result.axes;
  const double scale = norm_squared(m);
  for (int sweep = 0; sweep < kSweepsMax; ++sweep) {
    if (!(a(0, 1) * a(0, 1) + a(0, 2) * a(0, 2) + a(1, 2) * a(1, 2) > 1e-34 * scale)) break;
    for (std::size_t p = 0; p < 2; ++p)
      for (std::size_t q = p + 1; q < 3; ++q) {
        if (a(p, q) == 0) continue;
        // Tangent of the smaller of the two angles that rotate a(p, q) to zero.
        const double half = (a(q, q) - a(p, p)) / (2 * a(p, q));
        const double t = (half >= 0 ? 1 : -1) / (std::abs(half) + std::sqrt(half * half + 1));
        const double c = 1 / std::sqrt(t * t + 1);
        const double s = t * c;
        for (std::size_t k = 0; k < 3; ++k) {
          const double kp = a(k, p);
          a(k, p) = c * kp - s * a(k, q);
          a(k, q) = s * kp + c * a(k, q);
        }
        for (std::size_t k = 0; k < 3; ++k) {
          const double pk = a(p, k);
          a(p, k) = c * pk - s * a(q, k);
          a(q, k) = s * pk + c * a(q, k);
          const double kp = v(k, p);
          v(k, p) = c * kp - s * v(k, q);
          v(k, q) = s * kp + c * v(k, q);
        }
      }
  }
  result.values = {a(0, 0), a(1, 1), a(2, 2)};
  return result;
}

Sym3 log(const Sym3& m) {
  Sym3 off = m;
  off.add_to_diagonal(-1);
  if (!(norm_squared(off) <= kLogSeries * kLogSeries)) return by_axes(m, [](double value) { return std::log(value); });
  // log m = 2 artanh z with z = (m - I) (m + I)^-1, whose norm is below 0.082: six terms give a relative error of
  // 1e-14.
  Sym3 sum = m;
  sum.add_to_diagonal(1);
  const Sym3 z = product(off, inverse(sum));
  const Sym3 square = product(z, z);
  Sym3 series = (1.0 / 11) * square;
  for (const double term : {1.0 / 9, 1.0 / 7, 1.0 / 5, 1.0 / 3}) {
    series.add_to_diagonal(term);
    series = product(series, square);
  }
  series.add_to_diagonal(1);
  return 2.0 * product(series, z);
}

Sym3 exp(const Sym3& m) {
  if (!(norm_squared(m) <= kExpSeries * kExpSeries)) return by_axes(m, [](double value) { return std::exp(value); });
  Sym3 series = (1.0 / 7) * m;
  for (const double term : {1.0 / 6, 1.0 / 5, 1.0 / 4, 1.0 / 3, 1.0 / 2}) {
    series.add_to_diagonal(1);
    series = term * product(series, m);
  }
  series.add_to_diagonal(1);
  series = product(series, m);
  series.add_to_diagonal(1);
  return series;
}

}  // namespace rcb::solvers
