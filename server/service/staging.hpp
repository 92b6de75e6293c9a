// Prepare: the particles of a push on the ranks that hold them, checked, beside the scene's and not yet in it.
#pragma once

#include <optional>
#include <string>

#include "server/service/context.hpp"

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
  std::optional<double> step_seconds;  // the solver's own, since its last push
};

struct Staged {
  std::uint64_t n = 0;
  bool ids = false;               // ids aren't 0..n-1
  particles::ParticleSet arrays;  // this rank's; ids only at a first push, weights only if they came with it
  std::uint64_t bytes = 0;        // of all arrays as received
  double seconds = 0;             // to receive and stage
};

// Local. Errors: invalid_argument.
Result<PushRequest> read_push(const wire::Json& request);

// Collective. The scene is untouched. Errors: what the push has wrong, the same on every rank.
Result<Staged> prepare(Context& context, const Scene& scene, const PushRequest& push);

// Collective. Finite positions and weights, weights >= 0, ids >= 0; the first offender is named: at a first push by its
// row (`first_row` is this rank's first), later by its id.
Status check_values(partition::Comm& comm, const particles::ParticleView& view, bool first, std::uint64_t first_row);

}  // namespace rcb::service
