// Buckets, as in sample sort (Frazer and McKellar, J. ACM 17, 1970, doi:10.1145/321592.321600): before any cut is
// known, the splitters of a sample divide the particles. Those that a cut is expected among have a bucket of their own;
// all other buckets lie as a whole on one side of it. So the search of its key looks at few points, and a bucket that
// is never divided is never read again.
//
// Invariants
// 1. What bucket a particle is in, and where a cut is expected, changes the time of the search only.
#pragma once

#include <cstdint>
#include <span>

#include "common/geometry/box.hpp"
#include "common/particles/particle_set.hpp"
#include "common/partition/search/splitters.hpp"

namespace rcb::partition {

// One for each node of the splitters and for each of their leaves, of the same number.
inline constexpr std::size_t kBuckets = 2 * Splitters::kNodes + 1;

// Sets bucket[i] to the number of the first node, on the way down, where particle i may lie on either side of the cut;
// if there is none, to that of its leaf. Returns the particles' bounding box. Local.
geometry::Box sort_into_buckets(const particles::ParticleView& particles, const Splitters& splitters,
                                std::span<std::uint8_t> bucket);

}  // namespace rcb::partition
