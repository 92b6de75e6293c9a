// A first partition from a guess: every rank guesses the cuts from the same sample, and one pass finds the particles'
// parts under them. The rest is a repartition (repartition.hpp), which searches few particles.
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
//   in_vain  if nothing came of it: `reductions` and `traffic` of what was tried
std::optional<PartitionResult> partition_from_guess(comm::Comm& comm, const particles::ParticleView& particles,
                                                    const PartitionOptions& options, PartitionResult& in_vain);

}  // namespace rcb::partition
