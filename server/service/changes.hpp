// What a push may say beyond "here are all positions": that few or none moved since a base step, that particles are
// inserted and removed, that positions came in single precision.
//
// Invariants
// 1. Everything is checked in prepare, on all ranks; the commit that follows can't fail.
// 2. Work and memory are in proportion to what the push names, but for the index of ids, which is made once in a scene
//    that needs it and then kept up with the particles.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "common/base/status.hpp"
#include "server/service/context.hpp"
#include "server/service/scan.hpp"

namespace rcb::service {

// Whose positions a push brings.
enum class Moved { all, some, none };

struct PushChanges {
  Moved moved = Moved::all;
  bool single = false;                    // positions were float32 on the wire
  std::optional<std::int64_t> base_step;  // the step that the others' positions are those of
  std::vector<std::uint64_t> counts;      // moved some: particles in each rank's slice; order "id": in the one slice
  std::uint64_t inserted = 0;
  std::uint64_t removed = 0;
  bool own_ids = false;  // the inserted bring their ids; else the service chooses them

  bool edits() const { return inserted > 0 || removed > 0; }
  std::uint64_t moving(std::uint64_t n) const;  // particles whose positions come
};

// Inserted and removed particles, checked; nothing of the scene is changed yet.
struct Edits {
  std::uint64_t inserted = 0;  // by all ranks together
  std::uint64_t removed = 0;
  std::vector<std::uint64_t> removed_slots;  // of this rank, ascending
  particles::ParticleSet arriving;           // the inserted that this rank owns, ascending id
  Buffer<std::int32_t> arriving_part;
  Buffer<std::int32_t> inserted_part;       // of all inserted, in the order given
  std::vector<std::int32_t> removed_parts;  // of all removed, in no order
  bool ids = false;                         // ids aren't 0..n-1 any more
  std::optional<std::int64_t> first_id;     // of those that the service chose, which are consecutive
  std::uint64_t id_next = 0;                // above every id that the scene ever had

  bool any() const { return inserted > 0 || removed > 0; }
};

// The fields of push.begin. Errors: invalid_argument. Local.
Result<PushChanges> read_changes(const wire::Json& request, bool by_id, int ranks);

// Whether the scene can take them at all. Errors: invalid_argument, base_lost. Local, the same on every rank.
Status check_changes(const Scene& scene, const PushChanges& changes, bool weights);

// Takes the slices of inserted and removed particles out of context.slices (rank 0) and checks them. Collective.
Result<Edits> prepare_edits(Context& context, Scene& scene, const PushChanges& changes);

// This rank's share of a subset, as prepare() stages it: ids are filled in, slots are those of the scene.
struct Subset {
  Buffer<std::uint64_t> slot;  // ascending
};

// Brings the moved particles of a push to their ranks: positions and ids into `arrays`, their slots into `subset`.
// staged: this rank's slice came straight to it. `ready`: what this rank alone knows to be wrong, to be agreed on with
// the reduction that follows. Errors: what the slices have wrong, the same on every rank. Collective.
Status receive_subset(Context& context, Scene& scene, const PushChanges& changes, bool by_id, bool staged,
                      particles::ParticleSet& arrays, Subset& subset, Status& ready);

// Drops what is removed anyway. Local.
void forget_removed(const Edits& edits, Drift& drift);

}  // namespace rcb::service
