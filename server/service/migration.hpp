// Migration: every particle straight to the rank that owns its part, once, and the plan kept in step with it.
#pragma once

#include <cstdint>
#include <vector>

#include "server/service/changes.hpp"
#include "server/service/context.hpp"
#include "server/service/scan.hpp"

namespace rcb::service {

// Moves each local particle whose part another rank owns, with its part, and brings scene.particles, scene.part and
// the plan up to date. scene.part says the new parts, scene.options.parts how many.
//   first  the scene's first partition: the plan becomes a full one whatever moved
// Returns how many particles changed their rank, on every rank. Collective.
std::uint64_t migrate(partition::Comm& comm, Scene& scene, bool first);

// The same after a step with new cuts; touched: at least the slots of all whose part isn't that before the step,
// ascending. Cost in proportion to them. Collective.
std::uint64_t migrate_touched(partition::Comm& comm, Scene& scene, std::vector<std::uint64_t> touched);

// The same after a step without new cuts: only particles that drifted are looked at. Where sums.migrating
// is 0 nothing changes. Collective.
std::uint64_t migrate_drifted(partition::Comm& comm, Scene& scene, const Drift& drift, const StepSums& sums);

// Insertions and removals take place: particles, parts, n, ids and the plan; drift's slots are brought up to date.
// Collective.
void apply_edits(partition::Comm& comm, Scene& scene, Edits& edits, Drift& drift);

}  // namespace rcb::service
