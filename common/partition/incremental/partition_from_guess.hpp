// A first partition from a guess: rank 0 guesses the cuts from a sample and tells the others, and one pass finds the
// particles' parts under them. The rest is a repartition (repartition.hpp), which searches few particles.
//
// Invariants
// 1. The tree and the parts are those of a full search; `rounds` and `reductions` aren't.
#pragma once

#include <optional>

#include "common/comm/comm.hpp"
#include "common/particles/particle_set.hpp"
#include "common/partition/search/request.hpp"
#include "common/partition/search/sample.hpp"
#include "common/partition/search/sorted_sample.hpp"

namespace rcb::partition {

// False if these options rule a guess out: with many parts most particles would be near some cut, and with hysteresis
// the previous tree influences the axes. Local.
bool may_guess(const PartitionOptions& options);

// nullopt, on all ranks, if no cut of the root was found. `options` must be valid, and allow a guess. Collective.
//   large    of all particles
//   sample   its sample, on rank 0; is given the outermost particles where they are looked for
//   in_vain  `reductions` so far; if nothing came of it, also those and the `traffic` of what was tried
std::optional<PartitionResult> partition_from_guess(comm::Comm& comm, const particles::ParticleView& particles,
                                                    const PartitionOptions& options, const LargeSetSample& large,
                                                    SortedSample& sample, PartitionResult& in_vain);

}  // namespace rcb::partition
