// A cut tree as JSON for clients: its cuts in preorder, and the region of each part.
#pragma once

#include "common/cuts/cuts.hpp"
#include "common/wire/message.hpp"

namespace rcb::service {

// The cuts of those of the nodes [first, last) that exist.
wire::Json cuts_json(const cuts::CutTree& tree, int first, int last);
// The regions of the parts [first, last).
wire::Json regions_json(const cuts::CutTree& tree, int first, int last);
// {"part","axis","width"}, or null.
wire::Json narrowest_json(const cuts::Cuts& cuts);

}  // namespace rcb::service
