// A search among all particles, where no cuts are in force.
#pragma once

#include <optional>

#include "common/comm/comm.hpp"
#include "common/partition/rules/request.hpp"

namespace rcb::partition {

// `options` must be valid, and the method one whose cuts are searched.
// nullopt if go_on said no. Collective.
std::optional<PartitionResult> search_all(comm::Comm& comm, const particles::ParticleView& particles,
                                          const PartitionOptions& options, const comm::GoOn& go_on);

}  // namespace rcb::partition
