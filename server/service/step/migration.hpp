// Migration: moves every particle once, straight to the rank that owns its part, and updates the layout.
#pragma once

#include <cstdint>
#include <vector>

#include "server/service/context/context.hpp"
#include "server/service/push/edits.hpp"
#include "server/service/push/scan.hpp"

namespace rcb::service {

// Collective. Moves each local particle whose part another rank owns, and updates scene.particles, scene.part and the
// layout. scene.part has the new parts, scene.options.parts their number. Returns on every rank how many particles
// changed rank in all.
//   first  the scene's first partition: always a full change of the layout
std::uint64_t migrate(comm::Comm& comm, Scene& scene, bool first);

// The same after a step with new cuts. touched: at least the slots of all particles whose part changed in the step,
// ascending. The cost is proportional to their number. Collective.
std::uint64_t migrate_touched(comm::Comm& comm, Scene& scene, std::vector<std::uint64_t> touched);

// The same after a step without new cuts: considers drifted particles only. Nothing changes if sums.migrating is 0.
// Collective.
std::uint64_t migrate_drifted(comm::Comm& comm, Scene& scene, const Drift& drift, const StepSums& sums);

// Carries out insertions and removals: updates particles, parts, n, ids and the layout, and the slots in `drift`.
// Collective.
void apply_edits(comm::Comm& comm, Scene& scene, Edits& edits, Drift& drift);

}  // namespace rcb::service
