// The one pass over the positions of a later step: which particles left their part, and is every value finite?
//
// Invariants
// 1. A particle strictly inside the region of its old part is still in it, and its coordinates are finite (a region's
//    bounds are compared strictly, and no infinity or NaN lies strictly between two numbers). All others, few as a
//    rule, are copied out and asked of the cut tree, which alone decides.
// 2. Nothing of the scene is changed.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/particles/block_ranges.hpp"
#include "common/partition/comm.hpp"
#include "server/service/scene.hpp"

namespace rcb::service {

// Particles whose part changed by moving, ascending slots.
struct Drift {
  Buffer<std::uint64_t> slot;
  Buffer<std::int32_t> part;

  std::size_t count() const { return slot.size(); }
};

struct Scan {
  bool fault = false;  // a value that isn't finite, or a weight < 0; the rest is then unspecified
  Drift drift;         // to the new parts
  // Of blocks whose particles were all of one part, if the pass looked at all positions; of others everything.
  particles::BlockRanges ranges;
};

// The regions of this rank's parts, kept as long as the cuts are in force. Local.
void refresh_regions(Scene& scene, int rank, int ranks);

// Local. view: the new positions (and weights, if any) of the scene's particles, with its ids.
//   marks  what the pass at arrival found (arrival.hpp): blocks with 0 are passed over; empty: all are looked at
// Cost: one read of the positions, without marks; no memory but a byte a particle, and for those near or beyond their
// region's bounds.
Scan scan_positions(Scene& scene, const particles::ParticleView& view, std::span<const std::uint8_t> marks, int rank,
                    int ranks);

// The same of few: view holds, with their ids, the particles of these ascending slots. Local.
Scan scan_subset(Scene& scene, const particles::ParticleView& view, std::span<const std::uint64_t> slots, int rank,
                 int ranks);

// What all ranks' scans come to.
struct StepSums {
  static constexpr int kPartsMax = 1024;  // more parts: their changes of count are summed only where any drifted
  static constexpr int kRanksMax = 16;  // more ranks: who sends how much to whom is told when it is known that any does

  std::uint64_t faults = 0;                 // ranks that have one
  std::uint64_t drifted = 0;                // particles
  std::uint64_t migrating = 0;              // particles whose new part another rank owns
  std::vector<std::uint64_t> from_to;       // [ranks][ranks]; empty above kRanksMax
  std::vector<std::uint64_t> count_change;  // by part, mod 2^64; empty above kPartsMax, or where nobody needs it
};

// Collective, one reduction.
StepSums sum_scans(partition::Comm& comm, const Scene& scene, const Scan& scan, bool fault);
// By part, mod 2^64. Local.
std::vector<std::uint64_t> count_changes(const Scene& scene, const Drift& drift);

}  // namespace rcb::service
