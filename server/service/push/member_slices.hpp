// Joins the slices that the members of a parallel solver send straight to a rank into the rank's one slice.
//
// A member sends a rank those particles of the member's parts that the rank holds, in ascending slots. So the parts
// alone tell which member has the value for the next slot, and no ids are needed. A member that brings only the few
// that moved names their slots.
#pragma once

#include <array>
#include <span>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/comm/comm.hpp"
#include "server/api/push.hpp"
#include "server/service/context/order.hpp"
#include "server/service/push/arrays.hpp"
#include "server/service/scene/scene.hpp"

namespace rcb::service {

// slices: one for each member that brings particles here. Replaced by the one slice of this rank, in the layout's
// order, with the scene's positions where a member brings none. If one member's slice is all of it, and came by socket,
// it isn't copied; otherwise the cost is one pass over each array. Returns whether it was joined in `room`. Local.
//   types  of the arrays that each slice must have; of few particles: x (y, z) and slot
//   room   memory to join the positions in
// Errors: stale_plan if a member sends more or fewer particles than its parts have here, or those of other parts;
// invalid_argument; those of SharedSource; too_large.
Result<bool> join_member_slices(const comm::Comm& comm, const Scene& scene, std::span<const api::Moved> moved_by,
                                const ArrayTypes& types, std::array<Buffer<double>, 3>& room,
                                std::vector<PushSlice>& slices);

// The same where every member brings few particles or none: one slice of x (y, z) and slot, in ascending slots. Work in
// proportion to these. Local. Errors: invalid_argument, stale_plan.
Status join_few_of_members(const comm::Comm& comm, const Scene& scene, int members, std::vector<PushSlice>& slices);

}  // namespace rcb::service
