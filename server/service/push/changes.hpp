// Pushes other than of all positions in double precision: only some or no particles moved since a base step,
// insertions, removals, positions in single precision.
//
// Invariants
// 1. prepare() checks everything, on all ranks, so the commit that follows can't fail.
// 2. Work is proportional to the number of particles that the push names, a rank's memory to those of them that are its
//    own. The exception is the index of ids: it is built once, in a scene that needs it, and then updated with the
//    particles.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "common/base/status.hpp"
#include "server/api/push.hpp"
#include "server/service/context/context.hpp"
#include "server/service/push/scan.hpp"

namespace rcb::service {

using api::Moved;

struct PushRequest : api::Push {
  bool staged = false;          // the ranks received their slices directly
  std::vector<Moved> moved_by;  // by member of a parallel solver; empty: a single client pushes

  int members() const { return static_cast<int>(moved_by.size()); }
};

// Insertions and removals, checked but not yet applied to the scene.
struct Edits {
  std::uint64_t inserted = 0;  // on all ranks together
  std::uint64_t removed = 0;
  std::vector<std::uint64_t> removed_slots;  // this rank's, ascending
  particles::ParticleSet arriving;           // inserted particles of this rank's parts, ascending id
  Buffer<std::int32_t> arriving_part;
  Buffer<std::int32_t> inserted_part;          // on rank 0: of all inserted particles, in the order of the push
  std::vector<std::uint64_t> inserted_counts;  // by part, on every rank; empty if particles have weights
  Buffer<std::int32_t> removed_parts;          // of all removed particles, in no order
  bool ids = false;                            // after the edits ids aren't 0..n-1
  std::optional<std::int64_t> first_id;        // first of the consecutive ids that the service chose
  std::uint64_t id_next = 0;                   // above every id that the scene has ever had

  bool any() const { return inserted > 0 || removed > 0; }
};

// Checks whether the changes suit the scene's state. Errors: invalid_argument, base_lost, too_large. Local, with the
// same result on every rank.
Status check_changes(const Scene& scene, const api::Push& push);

// Takes the slices of inserted and removed particles out of context.slices (rank 0) and checks them. Collective.
Result<Edits> prepare_edits(Context& context, Scene& scene, const api::Push& push);

// This rank's moved particles in a push of some: the scene's slots for the staged arrays, whose ids are then filled in.
struct Subset {
  Buffer<std::uint64_t> slot;  // ascending
};

// Collective. Brings the moved particles of a push to their ranks: positions and ids into `arrays`, their slots into
// `subset`. `ready` gets a fault that only this rank knows of; the
// reduction that follows lets all ranks agree on it. Errors: faults of the slices, the same on every rank.
Status receive_subset(Context& context, Scene& scene, const PushRequest& push, particles::ParticleSet& arrays,
                      Subset& subset, Status& ready);

// Drops the drifted particles that the same push removes. Local.
void forget_removed(const Edits& edits, Drift& drift);

}  // namespace rcb::service
