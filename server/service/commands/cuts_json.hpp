// A cut tree for clients: as JSON, its cuts in preorder and the region of each part; or as arrays.
#pragma once

#include "common/cuts/cuts.hpp"
#include "common/wire/message.hpp"
#include "server/service/context/context.hpp"
#include "server/service/push/request.hpp"

namespace rcb::service {

// The cuts of those of the nodes [first, last) that exist.
wire::Json cuts_json(const cuts::CutTree& tree, int first, int last);
// The regions of the parts [first, last).
wire::Json regions_json(const cuts::CutTree& tree, int first, int last);
// {"part","axis","width"}, or null.
wire::Json narrowest_json(const cuts::Cuts& cuts);
// Adds the cuts as arrays (cut_arrays.hpp) to the answer: axes, at, id and, unless parts are equal, part_sizes. What
// else there is to say of them goes into `json`, which is the answer's or an object within it. Errors: too_large (no
// memory).
Status put_cut_arrays(const Context& context, Response& response, wire::Json& json, Scene& scene);
// The same to a push's answer, in a field "cuts", if its client asks for it and knows others, and if there is memory.
void put_cuts_unless_known(const Context& context, Response& response, Scene& scene, const PushRequest& push);

}  // namespace rcb::service
