// Scan: the single pass over the positions in every step but the first. Finds the particles that left their part, and
// checks that every value is finite.
//
// Invariants
// 1. A particle strictly inside the region of its old part is still in that part and has finite coordinates (no
//    infinity or NaN lies strictly between two numbers). All others, usually few, are copied and classified by the cut
//    tree, which alone decides.
// 2. Nothing of the scene is changed, except its cached regions.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/comm/comm.hpp"
#include "common/particles/block_ranges.hpp"
#include "server/service/push/shared_source.hpp"
#include "server/service/scene/scene.hpp"

namespace rcb::service {

// Particles that moved into another part, and that part; in ascending slots.
struct Drift {
  Buffer<std::uint64_t> slot;
  Buffer<std::int32_t> part;

  std::size_t count() const { return slot.size(); }
};

struct Scan {
  bool fault = false;  // a value isn't finite or a weight is < 0; the rest is then unspecified
  Drift drift;         // with the new parts
  // By block of 64 particles, set if all particles were scanned: exact where all particles of the block were in one
  // part, else Range::everything().
  particles::BlockRanges ranges;
};

// Local.
//   view    the new positions (and weights, if any) of the scene's particles, with their ids
//   ranges  of the blocks' positions, if known
// Cost: one read of the positions or, with ranges, of those of the blocks that don't lie within their part; memory for
// the drift and under a byte a particle for the blocks' ranges.
Scan scan_positions(Scene& scene, const particles::ParticleView& view, particles::BlockRanges ranges, int rank,
                    int ranks);

// The same, reading the positions of this rank's particles from memory that a client shares into `staged`, which has
// room for them. Their weights, if any, are there already. One pass over the positions. Local.
//   rows  in that memory, of the particles
Scan scan_shared(Scene& scene, const SharedSource& source, std::span<const particles::Id> rows,
                 particles::ParticleSet& staged, int rank, int ranks);

// The same for some particles: view holds those of these ascending slots, with their ids. Local.
Scan scan_subset(Scene& scene, const particles::ParticleView& view, std::span<const std::uint64_t> slots, int rank,
                 int ranks);

// The sums of all ranks' scans.
struct StepSums {
  static constexpr int kPartsMax = 1024;  // with more parts, count_change isn't part of this reduction
  static constexpr int kRanksMax = 16;    // with more ranks, from_to isn't part of this reduction

  std::uint64_t faults = 0;                 // ranks with a fault
  std::uint64_t drifted = 0;                // particles
  std::uint64_t migrating = 0;              // particles whose new part another rank owns
  std::vector<std::uint64_t> from_to;       // [from][to]: migrating particles; empty above kRanksMax
  std::vector<std::uint64_t> count_change;  // by part: change, mod 2^64; empty above kPartsMax or with weights
};

// Collective, one reduction.
StepSums sum_scans(comm::Comm& comm, const Scene& scene, const Scan& scan, bool fault);
// Change of each part's count by the drift, mod 2^64. Local.
std::vector<std::uint64_t> count_changes(const Scene& scene, const Drift& drift);

}  // namespace rcb::service
