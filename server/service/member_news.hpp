// What the members of a parallel solver are told after a step: whose part changed, who hands what to whom, and where
// particles stand on the ranks.
//
// Invariants
// 1. What A is told to give to B is what B is told to get from A.
// 2. Nothing is remembered from step to step: members' pushes tell who has what, by ids, or by the parts that were in
//    force, where they came straight to the ranks.
#pragma once

#include <cstdint>
#include <vector>

#include "server/service/context.hpp"
#include "server/service/step.hpp"

namespace rcb::service {

// Particles in ascending id, on rank 0 alone. part and slot (on the part's rank) are those after the step.
struct Whereabouts {
  Buffer<particles::Id> id;
  Buffer<std::int32_t> member;  // that pushed it
  Buffer<std::int32_t> part;
  Buffer<std::uint64_t> slot;
};

// Fills in the part of all particles, and, with places, the slot; id and member are there. Collective.
void find_all(Context& context, const Scene& scene, bool places, Whereabouts& all);

// A rank's particles before a step.
struct PlacesBefore {
  explicit PlacesBefore(const Scene& scene) : id(scene.particles.id), part(scene.part) {}
  Buffer<particles::Id> id;
  Buffer<std::int32_t> part;
};

// Those whose rank, slot or member is another than before; each member had the particles of its parts. Collective.
Whereabouts find_changed(Context& context, const Scene& scene, const PlacesBefore& before, int members);

struct NewsTerms {
  int members = 1;
  bool changes = false;
  bool follow = false;
  bool places = false;
};

// For each member in turn the arrays that the terms ask for: changed_id, changed_part; leave_id, leave_to, enter_id,
// enter_from, enter_part; place_id, place_rank, place_slot. Each list in ascending id. Local, on rank 0.
//   known  all particles, or all that find_changed() finds
//   ranks  of the service
std::vector<wire::Array> member_news(const Scene& scene, const NewsTerms& terms, int ranks, const Whereabouts& known,
                                     const PartChanges& changes);

}  // namespace rcb::service
