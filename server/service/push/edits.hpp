// Insertions and removals that a push brings. They are all checked here, on all ranks, so that the commit that follows
// can't fail. Work is proportional to their number, a rank's memory to those of them that are its own.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "common/base/status.hpp"
#include "server/api/push.hpp"
#include "server/service/context/context.hpp"
#include "server/service/push/scan.hpp"

namespace rcb::service {

// Checked but not yet applied to the scene.
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

// The first of `count` consecutive ids from `next` on. Errors: invalid_argument, if there aren't as many.
Result<particles::Id> first_of_ids(std::uint64_t next, std::uint64_t count);

// Takes the slices of inserted and removed particles out of context.slices (rank 0) and checks them. Collective.
Result<Edits> prepare_edits(Context& context, Scene& scene, const api::Push& push);

// Drops the drifted particles that the same push removes. Local.
void forget_removed(const Edits& edits, Drift& drift);

}  // namespace rcb::service
