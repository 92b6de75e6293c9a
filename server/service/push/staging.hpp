// Room `push`: turns received slices into checked particles on the ranks that hold them. A failure here changes
// nothing.
//
// Prepare: brings the particles of a push to the ranks that hold them and checks them. They are kept beside the scene's
// particles, not yet in the scene.
#pragma once

#include <optional>
#include <string>

#include "server/service/context/context.hpp"
#include "server/service/push/edits.hpp"
#include "server/service/push/request.hpp"
#include "server/service/push/scan.hpp"
#include "server/service/push/subset.hpp"

namespace rcb::service {

struct Staged {
  std::uint64_t n = 0;
  bool ids = false;                    // ids aren't 0..n-1
  particles::ParticleSet arrays;       // this rank's; ids only at a first push, weights only if sent
  std::optional<SharedSource> source;  // of positions that the scan is to read
  Buffer<particles::Id> rows;          // in `source`, of this rank's particles; empty: their ids
  bool joined = false;                 // the positions were joined from members' slices, in memory of the scene's
  Subset subset;                       // Moved::some: the slots of `arrays`, which then have ids
  Edits edits;
  std::uint64_t bytes = 0;  // of all arrays, as received
  double seconds = 0;       // time to receive and stage
  Scan scan;                // unset at a scene's first push
  StepSums sums;

  // The ranges of the blocks' positions; nullptr if no scan has read all positions.
  const particles::BlockRanges* ranges() const { return scan.ranges.known() ? &scan.ranges : nullptr; }
};

// Number of particles that the rank holds before a push of n particles: those of its parts or, at a first push, of its
// block of rows. Local.
std::uint64_t held_by(const Scene& scene, std::uint64_t n, int rank, int ranks);

// Collective. Leaves the scene as it was, except for what it caches (regions, index of ids, next id). Errors: faults of
// the push, the same on every rank. If the ranks received their slices directly, a step after the first costs one scan
// and one reduction.
Result<Staged> prepare(Context& context, Scene& scene, const PushRequest& push);

// Gives the memory that the commit swapped out to the next push, so that a step touches no fresh memory. Local.
void give_back(Context& context, Scene& scene, const PushRequest& push, Staged& staged);

}  // namespace rcb::service
