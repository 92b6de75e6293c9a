// Scan: the single pass over the positions of a step whose rows are the particles that a rank holds. It reads them from
// memory that a client shares, finds the particles that left their part, and checks that every value is finite.
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
  // By block of 64 particles: exact where all particles of the block were in one part, else Range::everything().
  particles::BlockRanges ranges;
};

// Reads the positions of this rank's particles into `staged`, which has room for them. Their weights, if any, are there
// already. Local.
Scan scan_shared(Scene& scene, const SharedSource& source, particles::ParticleSet& staged, int rank, int ranks);

// By how much the count of each part changes by this rank's drift, mod 2^64. scene.part has the parts before. Local.
std::vector<std::uint64_t> count_changes(const Scene& scene, const Drift& drift);

}  // namespace rcb::service
