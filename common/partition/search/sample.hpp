// A sample: some of every rank's particles, on all ranks or on rank 0 alone.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/comm/comm.hpp"
#include "common/particles/particle_set.hpp"
#include "common/partition/search/request.hpp"

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
std::vector<std::size_t> pick(std::size_t count, std::uint64_t stride);

// [particles.count], if these are wanted, which is the same on all ranks.
using PartsOfSlots = std::optional<std::span<const std::int32_t>>;

// Gathers the particles in these slots of every rank. Collective (one gather).
Sample share_sample(comm::Comm& comm, const particles::ParticleView& particles, std::span<const std::size_t> slots,
                    const PartsOfSlots& part = {});

// The same on rank 0 alone; elsewhere the sample is empty. Collective (one gather).
Sample gather_sample(comm::Comm& comm, const particles::ParticleView& particles, std::span<const std::size_t> slots,
                     const PartsOfSlots& part = {});

// A sample of a large set.
struct LargeSetSample {
  Sample sample;             // on rank 0; elsewhere empty
  std::uint64_t stride = 1;  // one of so many was sampled
};

// False if a set of so many particles is too small for a sample to save time. Local.
bool is_large(std::uint64_t count, int ranks, const BucketLimits& limits);

// nullopt if a sample would save no time, as with few particles or parts, or where no search could begin with buckets.
// Adds its collectives (one sum, and one gather) to `reductions`. Collective.
std::optional<LargeSetSample> sample_large_set(comm::Comm& comm, const particles::ParticleView& particles,
                                               const PartitionOptions& options, std::uint64_t& reductions);

}  // namespace rcb::partition
