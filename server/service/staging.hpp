// Prepare: the particles of a push on the ranks that hold them, checked, beside the scene's and not yet in it.
#pragma once

#include <optional>
#include <string>

#include "server/service/changes.hpp"
#include "server/service/context.hpp"
#include "server/service/scan.hpp"

namespace rcb::service {

// The fields of push.begin.
struct PushRequest {
  std::string session;
  std::int64_t step = 0;
  std::uint64_t n = 0;
  bool by_id = false;  // order "id": one slice with all particles, else one a rank in the plan's order
  std::uint64_t plan_version = 0;
  std::uint64_t plan_checksum = 0;
  bool weights = false;
  bool ids = false;
  bool changes = false;
  bool staged = false;                 // every rank has its slice already
  int members = 0;                     // that brought it, each its own; 0: it came from one client
  std::vector<bool> unmoved;           // by member: brings nothing, its particles stand where they stood
  std::optional<double> step_seconds;  // the solver's own, since its last push
  PushChanges what;
};

struct Staged {
  std::uint64_t n = 0;
  bool ids = false;                        // ids aren't 0..n-1
  particles::ParticleSet arrays;           // this rank's; ids only at a first push, weights only if they came with it
  std::shared_ptr<const Arrival> arrival;  // what was seen of `arrays` as they came, if it holds; or null
  Subset subset;                           // moved some: the slots of `arrays`, which has their ids then
  Edits edits;
  std::uint64_t bytes = 0;  // of all arrays as received
  double seconds = 0;       // to receive and stage
  Scan scan;                // of a later step
  StepSums sums;

  // Where the particles are, by block; null where no pass over all has told.
  const particles::BlockRanges* ranges() const {
    if (arrival) return &arrival->ranges();
    return scan.ranges.of[0].empty() ? nullptr : &scan.ranges;
  }
};

// Local. Errors: invalid_argument.
Result<PushRequest> read_push(const wire::Json& request, int ranks);

// The particles that rank r holds before a push of n: those of its parts, or its block of rows. Local.
std::uint64_t held_by(const Scene& scene, std::uint64_t n, int rank, int ranks);

// Collective. The scene is as it was, but for what it keeps about its regions. Errors: what the push has wrong, the
// same on every rank. A later step whose slices are staged costs one pass and one reduction.
Result<Staged> prepare(Context& context, Scene& scene, const PushRequest& push);

// What the commit swapped out is what the next push is received into, so that a step touches no fresh memory. Local.
void give_back(Context& context, const Scene& scene, const PushRequest& push, Staged& staged);

// Collective. Finite positions and weights, weights >= 0, ids >= 0; the first offender is named: at a first push by its
// row (`first_row` is this rank's first), later by its id.
Status check_values(partition::Comm& comm, const particles::ParticleView& view, bool first, std::uint64_t first_row);

}  // namespace rcb::service
