// What the members of a parallel solver are told after a step: which particles changed part, where particles are in the
// layout, and the ids of what they inserted.
//
// Nothing is remembered between steps. A push tells which member has which particles: by the ids it brings or, if it
// came straight to the ranks or brought few, by the parts before the step.
#pragma once

#include <cstdint>
#include <vector>

#include "server/service/context/context.hpp"
#include "server/service/step/step.hpp"

namespace rcb::service {

// Where particles stand after a step: the slot is one of the part's rank. In ascending id, on rank 0.
struct Whereabouts {
  Buffer<particles::Id> id;
  Buffer<std::int32_t> part;
  Buffer<std::uint64_t> slot;
};

// Particles and the members that pushed, held, or inserted them; on rank 0.
struct OfMembers {
  Buffer<particles::Id> id;
  Buffer<std::int32_t> member;
};

// A copy of this rank's ids and parts before a step.
struct PlacesBefore {
  explicit PlacesBefore(const Scene& scene) : id(scene.particles.id), part(scene.part) {}
  Buffer<particles::Id> id;
  Buffer<std::int32_t> part;
};

// The k-th entry is the index of the particle with the k-th smallest id. No sorting if the ids are 0..n-1 in any order.
Buffer<std::uint64_t> ascending(const Buffer<particles::Id>& ids);

// This rank's slots, ascending, that hold another particle than before the step, or one of another member, or none any
// more. Local.
Buffer<std::uint64_t> changed_slots(const Scene& scene, const PlacesBefore& before, int members);

// The particles in these slots of each rank; those in all slots if there is no list. Collective.
Whereabouts find_places(Context& context, const Scene& scene, const Buffer<std::uint64_t>* slots);

// The particles that were in these slots, each with the member of its part; in ascending id. Collective.
OfMembers holders_before(Context& context, const Scene& scene, const PlacesBefore& before,
                         const Buffer<std::uint64_t>& slots, int members);

struct ResultTerms {
  int members = 1;
  bool changes = false;
  bool places = false;
  bool inserted = false;  // by any member
};

struct MemberNews {
  PartChanges changes;
  // Whose a particle is: as pushed, or inserted, else as holders_before() says. One in no list has kept its member.
  OfMembers pushed, before;  // in ascending id
  OfMembers inserted;        // of each member in the order given
  Whereabouts places;
};

// Returns for each member in turn the arrays that the terms ask for: changed_id, changed_part; place_id, place_rank,
// place_slot, each list in ascending id; inserted_id, in the order given. Local, on rank 0.
//   ranks  number of ranks of the service
std::vector<wire::Array> member_results(const Scene& scene, const ResultTerms& terms, int ranks,
                                        const MemberNews& news);

}  // namespace rcb::service
