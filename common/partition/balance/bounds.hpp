// Minima and maxima over all ranks, of any number of things in one reduction.
#pragma once

#include <cstdint>
#include <vector>

#include "common/comm/comm.hpp"
#include "common/geometry/box.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::partition {

// What is added on each rank is taken, in the same order, as the least and the greatest of all ranks. All are reduced
// as minima of integers that keep the order; a greatest value is the complement of the least complement.
class AllMinMax {
 public:
  void add(std::uint64_t least, std::uint64_t most) { values_.insert(values_.end(), {least, ~most}); }
  void add(double lo, double hi) { add(geometry::order_bits(lo), geometry::order_bits(hi)); }
  void add(const geometry::Box& box, int dims) {
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) add(box.lo[a], box.hi[a]);
  }

  // All ranks have added the same number of things. Collective (one reduction for every 32 KiB, some hundred boxes).
  // Returns the number of reductions.
  std::uint64_t reduce(comm::Comm& comm) { return comm::all_min_in_messages(comm, values_); }

  void take(std::uint64_t& least, std::uint64_t& most) {
    least = values_[taken_++];
    most = ~values_[taken_++];
  }
  void take(double& lo, double& hi) {
    lo = geometry::value_of_order_bits(values_[taken_++]);
    hi = geometry::value_of_order_bits(~values_[taken_++]);
  }
  void take(geometry::Box& box, int dims) {
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) take(box.lo[a], box.hi[a]);
  }

 private:
  std::vector<std::uint64_t> values_;
  std::size_t taken_ = 0;
};

// The box of all ranks' particles; empty if there are none. Collective (one reduction).
inline geometry::Box bounding_box(comm::Comm& comm, const particles::ParticleView& particles) {
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
