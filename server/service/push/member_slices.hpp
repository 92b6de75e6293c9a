// Joins the slices that the members of a parallel solver send straight to a rank into the rank's one slice.
//
// A member sends a rank those particles of the member's parts that the rank holds, in ascending slots. So the parts
// alone tell which member has the value for the next slot, and no ids are needed.
#pragma once

#include <array>
#include <span>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/comm/comm.hpp"
#include "server/service/context/order.hpp"
#include "server/service/scene/scene.hpp"

namespace rcb::service {

// slices: one for each member with particles here; its `rank` is the member's number. Replaced by the one slice of this
// rank, in the layout's order. If one member's slice is all of it, and came by socket, it isn't copied; otherwise the
// cost is one pass over each array. Local.
//   unmoved  by member: it sends nothing, since its particles haven't moved
//   names    of the arrays that each slice must have
//   room     memory to join the positions in
// Errors: stale_plan if a member sends more or fewer particles than its parts have here; those of SharedSource;
// too_large.
Status join_member_slices(const comm::Comm& comm, const Scene& scene, const std::vector<bool>& unmoved,
                          std::span<const std::string> names, std::array<Buffer<double>, 3>& room,
                          std::vector<PushSlice>& slices);

}  // namespace rcb::service
