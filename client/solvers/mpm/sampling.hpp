// Fills a shape evenly with a given number of points, practically no two of which share a coordinate.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

#include "client/solvers/mpm/mat3.hpp"

namespace rcb::solvers {

// Positions, one array for each axis.
struct Cloud {
  std::array<std::vector<double>, 3> position;
  std::size_t size() const { return position[0].size(); }
};

struct Shape {
  Vec3 lo{};  // bounding box of the shape
  Vec3 hi{};
  double volume = 0;  // of the shape, > 0; an estimate is enough
  std::function<bool(const Vec3&)> inside;
};

// Exactly `count` points inside the shape: those of a cubic lattice oblique to the axes, each displaced at random by at
// most a tenth of the spacing. The spacing is just fine enough for `count` points; the few extra ones are removed by
// hash. The points are in the lattice's order. The same arguments give the same bits.
Cloud fill(const Shape& shape, std::size_t count, std::uint64_t seed);

}  // namespace rcb::solvers
