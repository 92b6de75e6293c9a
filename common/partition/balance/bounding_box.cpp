#include "common/partition/balance/bounding_box.hpp"

#include <algorithm>
#include <vector>

#include "common/geometry/axes.hpp"

namespace rcb::partition {

geometry::Box bounding_box(comm::Comm& comm, const particles::ParticleView& particles) {
  geometry::Box box;
  for (std::size_t a = 0; a < static_cast<std::size_t>(particles.dims); ++a)
    geometry::least_and_most({particles.position[a], particles.count}, box.lo[a], box.hi[a]);
  extend_by_all(comm, {&box, 1}, particles.dims);
  return box;
}

void extend_by_all(comm::Comm& comm, std::span<geometry::Box> boxes, int dims, std::span<std::uint64_t> more) {
  const auto axes = static_cast<std::size_t>(dims);
  std::vector<std::uint64_t> least;
  for (const geometry::Box& box : boxes)
    for (std::size_t a = 0; a < axes; ++a) {
      least.push_back(geometry::order_bits(box.lo[a]));
      least.push_back(~geometry::order_bits(box.hi[a]));
    }
  least.insert(least.end(), more.begin(), more.end());
  comm.all_min(least);
  auto next = least.begin();
  for (geometry::Box& box : boxes)
    for (std::size_t a = 0; a < axes; ++a) {
      box.lo[a] = geometry::value_of_order_bits(*next++);
      box.hi[a] = geometry::value_of_order_bits(~*next++);
    }
  std::copy(next, least.end(), more.begin());
}

}  // namespace rcb::partition
