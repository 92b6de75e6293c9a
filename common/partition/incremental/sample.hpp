// A sample: some of every rank's particles, replicated on all ranks.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/comm/comm.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::partition {

struct Sample {
  particles::ParticleSet particles;  // in rank order; weights are 1 where there are none
  Buffer<std::int32_t> part;         // [count]

  std::size_t count() const { return particles.count(); }
  double x(std::size_t axis, std::size_t k) const { return particles.position[axis][k]; }
};

// One slot of every `stride` of [0, count), chosen by a hash, since solvers' arrays may be periodic. Local.
std::vector<std::size_t> pick(std::size_t count, std::uint64_t stride);

// Gathers the particles in these slots of every rank. Collective (one gather).
//   part  [particles.count]; null: 0 for all
Sample share_sample(comm::Comm& comm, const particles::ParticleView& particles, const std::int32_t* part,
                    std::span<const std::size_t> slots);

}  // namespace rcb::partition
