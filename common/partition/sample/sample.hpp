// Room `sample`: what a few of the particles tell before any pass over all of them: where the cuts are expected, and
// how coordinates become integers. A guess: a wrong one costs time only.
//
// A sample: some of every rank's particles, on rank 0.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/comm/comm.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::partition {

// In rank order.
struct Sample {
  int dims = 3;
  std::array<Buffer<double>, geometry::kDimsMax> position;
  Buffer<std::int32_t> part;  // [count], if wanted

  std::size_t count() const { return position[0].size(); }
  double x(std::size_t axis, std::size_t k) const { return position[axis][k]; }
};

// One slot of every `stride` of [0, count), chosen by a hash, since solvers' arrays may be periodic. Local.
std::vector<std::size_t> sampled_slots(std::size_t count, std::uint64_t stride);

// The particles in these slots of every rank, on rank 0; elsewhere the sample is empty.
//   part  [particles.count], if these are wanted, which is the same on all ranks
// Collective (one gather).
Sample gather_sample(comm::Comm& comm, const particles::ParticleView& particles, std::span<const std::size_t> slots,
                     std::optional<std::span<const std::int32_t>> part = {});

}  // namespace rcb::partition
