#include "common/partition/balance/bounding_box.hpp"

#include <algorithm>
#include <array>
#include <cstdint>

#include "common/geometry/axes.hpp"

namespace rcb::partition {

geometry::Box bounding_box(comm::Comm& comm, const particles::ParticleView& particles) {
  std::array<std::uint64_t, 2 * geometry::kDimsMax> least{};
  least.fill(~std::uint64_t{0});
  const auto dims = static_cast<std::size_t>(particles.dims);
  for (std::size_t a = 0; a < dims && particles.count > 0; ++a) {
    const double* x = particles.position[a];
    const auto [lo, hi] = std::minmax_element(x, x + particles.count);
    least[a] = geometry::order_bits(*lo);
    least[geometry::kDimsMax + a] = ~geometry::order_bits(*hi);
  }
  comm.all_min(least);
  geometry::Box box;
  for (std::size_t a = 0; a < dims && least[0] != ~std::uint64_t{0}; ++a) {
    box.lo[a] = geometry::value_of_order_bits(least[a]);
    box.hi[a] = geometry::value_of_order_bits(~least[geometry::kDimsMax + a]);
  }
  return box;
}

}  // namespace rcb::partition
