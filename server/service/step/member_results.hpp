// What the members of a parallel solver are told after a step: which particles changed part, which they hand over to
// whom, and where particles are in the layout.
//
// Invariants
// 1. What member A is told to give to B is what B is told to get from A.
// 2. Nothing is remembered between steps. A push tells which member has which particles: by the ids it brings or, if it
//    came straight to the ranks or brought few, by the parts before the step.
#pragma once

#include <cstdint>
#include <vector>

#include "server/service/context/context.hpp"
#include "server/service/step/step.hpp"

namespace rcb::service {

// Particles in ascending id, on rank 0 only. part and slot (a slot of the part's rank) are those after the step.
struct Whereabouts {
  Buffer<particles::Id> id;
  Buffer<std::int32_t> member;  // the member that pushed the particle
  Buffer<std::int32_t> part;
  Buffer<std::uint64_t> slot;
};

// Fills in part and, if `places`, slot of all particles; the caller has filled in id and member. Collective.
void find_all(Context& context, const Scene& scene, bool places, Whereabouts& all);

// All particles before a step: id, and the member that pushed it or, of those that nobody pushed since they stood
// still, that of its part. pushed: ascending, on rank 0. Collective.
Whereabouts held_by_all(Context& context, const Scene& scene, int members, const Whereabouts& pushed);

// A copy of this rank's ids and parts before a step.
struct PlacesBefore {
  explicit PlacesBefore(const Scene& scene) : id(scene.particles.id), part(scene.part) {}
  Buffer<particles::Id> id;
  Buffer<std::int32_t> part;
};

// What the members inserted, each member's in the order given; on rank 0.
struct InsertedByMembers {
  Buffer<particles::Id> id;
  Buffer<std::int32_t> member;
  // Their parts when they arrived, before new cuts of the step. Empty: member_results() takes the parts from `known`.
  Buffer<std::int32_t> part;
};

// The particles whose rank, slot or member changed in the step, and those inserted. Before it each member had the
// particles of its parts. Collective.
Whereabouts find_changed(Context& context, const Scene& scene, const PlacesBefore& before, int members,
                         const InsertedByMembers& inserted);

struct ResultTerms {
  int members = 1;
  bool changes = false;
  bool follow = false;
  bool places = false;
  bool inserted = false;  // by any member
};

// Returns for each member in turn the arrays that the terms ask for: changed_id, changed_part; leave_id, leave_to,
// enter_id, enter_from, enter_part; place_id, place_rank, place_slot, each list in ascending id; inserted_id,
// inserted_part, in the order given. Local, on rank 0.
//   known  all particles, or those that find_changed() returned
//   ranks  number of ranks of the service
std::vector<wire::Array> member_results(const Scene& scene, const ResultTerms& terms, int ranks,
                                        const Whereabouts& known, const PartChanges& changes,
                                        const InsertedByMembers& inserted);

}  // namespace rcb::service
