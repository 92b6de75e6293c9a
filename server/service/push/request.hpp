// An order to push, as the service reads it, and whether it suits the scene's state.
#pragma once

#include <vector>

#include "common/base/status.hpp"
#include "common/wire/message.hpp"
#include "server/api/push.hpp"
#include "server/scene/policy.hpp"
#include "server/service/scene/scene.hpp"

namespace rcb::service {

using api::Moved;

struct PushRequest : api::Push {
  bool staged = false;          // the ranks received their slices directly
  scene::DecisionTerms terms;   // of rank 0's ledger
  std::vector<Moved> moved_by;  // by member of a parallel solver; empty: a single client pushes

  int members() const { return static_cast<int>(moved_by.size()); }
};

// Local. Errors: invalid_argument.
Result<PushRequest> read_order(const wire::Json& request, int ranks);

// Checks step, base step, number of particles and layout. Local, with the same result on every rank. Errors:
// stale_step, stale_plan, base_lost, invalid_argument, too_large.
Status check_request(const Scene& scene, const PushRequest& push);

}  // namespace rcb::service
