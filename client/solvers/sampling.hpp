// Fills a shape with exactly as many points as asked, evenly but with no two on a common coordinate plane.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

#include "client/solvers/mat3.hpp"

namespace rcb::solvers {

// One array an axis.
struct Cloud {
  std::array<std::vector<double>, 3> position;
  std::size_t size() const { return position[0].size(); }
};

struct Shape {
  Vec3 lo{};  // a box around the shape
  Vec3 hi{};
  double volume = 0;  // of the shape, > 0; a fair estimate is enough
  std::function<bool(const Vec3&)> inside;
};

// Exactly `count` points inside the shape: a cubic lattice oblique to the axes, each point shaken by a tenth of the
// spacing at most, just fine enough to hold that many; the few too many are left out, chosen by hash. The order is that
// of the lattice. The same arguments give the same bits.
Cloud fill(const Shape& shape, std::size_t count, std::uint64_t seed);

}  // namespace rcb::solvers
