// Symmetric 3 x 3 matrices, their logarithm and exponential, for the strains of a material law.
//
// 1. Near the identity (log) or zero (exp) both are short series, elsewhere they use the principal axes. At the
//    transition the two ways agree to 1e-13.
// 2. `product` is for matrices that commute, as functions of the same matrix do: only then is the product symmetric.
#pragma once

#include <array>
#include <cmath>

#include "client/solvers/mpm/mat3.hpp"

namespace rcb::solvers {

struct Sym3 {
  double xx = 0, yy = 0, zz = 0, xy = 0, xz = 0, yz = 0;

  double trace() const { return xx + yy + zz; }
  void add_to_diagonal(double value) {
    xx += value;
    yy += value;
    zz += value;
  }
  Mat3 full() const { return {{xx, xy, xz, xy, yy, yz, xz, yz, zz}}; }
};

inline Sym3 operator*(double s, const Sym3& m) { return {s * m.xx, s * m.yy, s * m.zz, s * m.xy, s * m.xz, s * m.yz}; }

// Frobenius norm, squared.
inline double norm_squared(const Sym3& m) {
  return m.xx * m.xx + m.yy * m.yy + m.zz * m.zz + 2 * (m.xy * m.xy + m.xz * m.xz + m.yz * m.yz);
}

inline double determinant(const Sym3& m) {
  return m.xx * (m.yy * m.zz - m.yz * m.yz) - m.xy * (m.xy * m.zz - m.yz * m.xz) + m.xz * (m.xy * m.yz - m.yy * m.xz);
}

inline Sym3 product(const Sym3& a, const Sym3& b) {
  return {a.xx * b.xx + a.xy * b.xy + a.xz * b.xz, a.xy * b.xy + a.yy * b.yy + a.yz * b.yz,
          a.xz * b.xz + a.yz * b.yz + a.zz * b.zz, a.xx * b.xy + a.xy * b.yy + a.xz * b.yz,
          a.xx * b.xz + a.xy * b.yz + a.xz * b.zz, a.xy * b.xz + a.yy * b.yz + a.yz * b.zz};
}

// m m^T.
inline Sym3 left_square(const Mat3& m) {
  const auto row = [&m](std::size_t i, std::size_t j) {
    return m(i, 0) * m(j, 0) + m(i, 1) * m(j, 1) + m(i, 2) * m(j, 2);
  };
  return {row(0, 0), row(1, 1), row(2, 2), row(0, 1), row(0, 2), row(1, 2)};
}

// Principal values and axes: column k of `axes` belongs to values[k].
// Cyclic Jacobi rotations; source: Golub and Van Loan 2013, section 8.5.
struct Principal {
  Vec3 values{};
  Mat3 axes;
};
Principal principal(const Sym3& m);

// Logarithm of a positive definite matrix; NaN for any other.
Sym3 log(const Sym3& m);
Sym3 exp(const Sym3& m);

}  // namespace rcb::solvers
