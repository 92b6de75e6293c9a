// What members of a parallel solver bring straight to a rank, put together to its slice.
//
// A member brings a rank the particles that stand there and belong to the member's parts, in ascending slots. So the
// parts alone tell whose value is the next one, and no id is needed.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/partition/comm.hpp"
#include "server/service/scene.hpp"
#include "server/service/service.hpp"

namespace rcb::service {

// slices: one for each member with particles here, its rank the member's number. Afterwards the one of this rank, in
// the plan's order; a member's that is all of it stays where it lies. Cost: else one pass over each array. Local.
//   unmoved  by member: brings nothing, since its particles stand where they stood
//   names    of the arrays that each slice must have
// Errors: stale_plan, where a member brings more or fewer than its parts have here; too_large.
Status join_member_slices(const partition::Comm& comm, const Scene& scene, const std::vector<bool>& unmoved,
                          std::span<const std::string> names, std::vector<PushSlice>& slices);

}  // namespace rcb::service
