// A partition of a large set from a guess: every rank makes the tree of a sample for itself, and one pass finds the
// parts under it. The rest is a repartition (repartition.hpp), which searches few particles: the set is read three
// times, and most particles are never quantised.
//
// It pays where the quantised points of all particles (quantised_points.hpp) don't fit in the caches, parts are few, so
// that few particles lie near a cut, and the sample determines every cut's axis.
//
// Invariants
// 1. The tree and the parts are those of a full search; `rounds` and `reductions` aren't.
#pragma once

#include <optional>

#include "common/comm/comm.hpp"
#include "common/particles/particle_set.hpp"
#include "common/partition/search/request.hpp"

namespace rcb::partition {

// nullopt, on all ranks, if options.limits or the sample rule out a guess. `options` must be valid. Collective.
//   reductions  becomes the number of collectives used, whether a partition came of it or not
std::optional<PartitionResult> partition_from_guess(comm::Comm& comm, const particles::ParticleView& particles,
                                                    const PartitionOptions& options, std::uint64_t& reductions);

}  // namespace rcb::partition
