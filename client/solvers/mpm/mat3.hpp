// The 3-D algebra that the solvers need: vectors and row-major 3 x 3 matrices, all inline.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>

namespace rcb::solvers {

using Vec3 = std::array<double, 3>;

struct Mat3 {
  std::array<double, 9> e{};  // row by row

  static constexpr Mat3 identity() { return {{1, 0, 0, 0, 1, 0, 0, 0, 1}}; }
  double& operator()(std::size_t row, std::size_t column) { return e[row * 3 + column]; }
  double operator()(std::size_t row, std::size_t column) const { return e[row * 3 + column]; }
};

inline Mat3 operator*(const Mat3& a, const Mat3& b) {
  Mat3 c;
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = 0; j < 3; ++j) c(i, j) = a(i, 0) * b(0, j) + a(i, 1) * b(1, j) + a(i, 2) * b(2, j);
  return c;
}

// m times its own transpose: symmetric.
inline Mat3 times_transpose(const Mat3& m) {
  Mat3 c;
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = 0; j < 3; ++j) c(i, j) = m(i, 0) * m(j, 0) + m(i, 1) * m(j, 1) + m(i, 2) * m(j, 2);
  return c;
}

inline double determinant(const Mat3& m) {
  return m(0, 0) * (m(1, 1) * m(2, 2) - m(1, 2) * m(2, 1)) - m(0, 1) * (m(1, 0) * m(2, 2) - m(1, 2) * m(2, 0)) +
         m(0, 2) * (m(1, 0) * m(2, 1) - m(1, 1) * m(2, 0));
}

// Sum of squares of the entries: trace(m m^T).
inline double sum_of_squares(const Mat3& m) {
  double sum = 0;
  for (const double value : m.e) sum += value * value;
  return sum;
}

inline double dot(const Vec3& a, const Vec3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
inline Vec3 cross(const Vec3& a, const Vec3& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
inline double norm(const Vec3& a) { return std::sqrt(dot(a, a)); }
inline Vec3 operator+(const Vec3& a, const Vec3& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
inline Vec3 operator-(const Vec3& a, const Vec3& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
inline Vec3 operator*(double s, const Vec3& a) { return {s * a[0], s * a[1], s * a[2]}; }

}  // namespace rcb::solvers
