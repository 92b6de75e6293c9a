// A partition of a large set from a guess: the tree of a sample, which every rank makes for itself, and one pass that
// finds the parts under it. From there on it is a repartition (repartition.hpp), which looks at few particles, so that
// the set is read three times, and no record of most particles is made.
//
// It pays where the records of all particles (records.hpp) don't fit in the caches, the parts are few, so that few
// particles lie near a cut, and the sample tells every cut's axis.
//
// Invariants
// 1. The tree and the parts are those of a search among all particles; `rounds` and `reductions` aren't.
#pragma once

#include <optional>

#include "common/partition/partition.hpp"

namespace rcb::partition {

// nullopt, on all ranks, where options.limits or the sample speak against it. The options are checked. Collective.
//   reductions  becomes the number of collectives used, whatever comes of them
std::optional<PartitionResult> partition_from_guess(Comm& comm, const particles::ParticleView& particles,
                                                    const PartitionOptions& options, std::uint64_t& reductions);

}  // namespace rcb::partition
