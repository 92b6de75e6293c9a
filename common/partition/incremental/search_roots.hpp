// A search among all particles of some nodes.
#pragma once

#include "common/partition/search/build_tree.hpp"

namespace rcb::partition {

// Cuts start.roots, not all of the tree, among all their particles, and writes start.part. On a rank where these are at
// most a quarter of the particles the search passes over copies of them; copies of more would take more memory than the
// search. Collective.
PartitionResult search_roots(comm::Comm& comm, const particles::ParticleView& particles,
                             const PartitionOptions& options, Start start);

}  // namespace rcb::partition
