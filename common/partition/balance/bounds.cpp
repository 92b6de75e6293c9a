#include "common/partition/balance/bounds.hpp"

namespace rcb::partition {

geometry::Box bounding_box(comm::Comm& comm, const particles::ParticleView& particles) {
  geometry::Box box;
  for (std::size_t a = 0; a < static_cast<std::size_t>(particles.dims); ++a)
    geometry::least_and_most({particles.position[a], particles.count}, box.lo[a], box.hi[a]);
  AllMinMax all;
  all.add(box, particles.dims);
  all.reduce(comm);
  all.take(box, particles.dims);
  return box;
}

}  // namespace rcb::partition
