// Positions: n positions in the caller's memory, as rows or as an array for each axis, of doubles or floats. Nothing is
// copied. A float is widened to double, which is exact.
#pragma once

#include <array>
#include <cstddef>
#include <span>

#include "common/geometry/axes.hpp"

namespace rcb::cuts {

struct Positions {
  std::array<const double*, geometry::kDimsMax> axis{};    // first element of each axis; null for float positions
  std::array<const float*, geometry::kDimsMax> axis_f4{};  // likewise; null for double positions
  std::size_t stride = 1;                                  // elements from one particle to the next
  std::size_t count = 0;
  int dims = 3;

  // xyz: [count][dims], C order.
  static Positions rows(const double* xyz, std::size_t count, int dims) {
    return of_rows(&Positions::axis, xyz, count, dims);
  }
  static Positions rows(const float* xyz, std::size_t count, int dims) {
    return of_rows(&Positions::axis_f4, xyz, count, dims);
  }
  // One contiguous array for each axis, each [count].
  static Positions axes(std::span<const double* const> axes, std::size_t count) {
    return of_axes(&Positions::axis, axes, count);
  }
  static Positions axes(std::span<const float* const> axes, std::size_t count) {
    return of_axes(&Positions::axis_f4, axes, count);
  }

  bool single() const { return axis_f4[0] != nullptr; }
  // Position i, widened to double; axes >= dims are 0.
  geometry::Point point(std::size_t i) const {
    geometry::Point p{};
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a)
      p[a] = single() ? static_cast<double>(axis_f4[a][i * stride]) : axis[a][i * stride];
    return p;
  }

 private:
  template <typename T>
  using Axes = std::array<const T*, geometry::kDimsMax>;

  template <typename T>
  static Positions of_rows(Axes<T> Positions::*member, const T* xyz, std::size_t count, int dims) {
    Positions p;
    p.stride = static_cast<std::size_t>(dims);
    p.count = count;
    p.dims = dims;
    for (std::size_t a = 0; xyz != nullptr && a < p.stride && a < geometry::kDimsMax; ++a) (p.*member)[a] = xyz + a;
    return p;
  }
  template <typename T>
  static Positions of_axes(Axes<T> Positions::*member, std::span<const T* const> axes, std::size_t count) {
    Positions p;
    p.count = count;
    p.dims = static_cast<int>(axes.size());
    for (std::size_t a = 0; a < axes.size() && a < geometry::kDimsMax; ++a) (p.*member)[a] = axes[a];
    return p;
  }
};

}  // namespace rcb::cuts
