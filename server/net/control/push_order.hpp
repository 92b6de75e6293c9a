// PushOrder: the order "push" to the ranks, which the blocks of a step make together.
#pragma once

#include "server/net/control/coordinator.hpp"

namespace rcb::net {

struct PushOrder {
  wire::Json request;
  OrderOptions options;
};

// Takes what has arrived of the step's blocks.
//
// The request has the fields of push of all blocks together, "seats", "terms" (of the decision), "counted_ids"
// (where counts have brought other particles than the ranks hold: the sum of their ids) and "blocks":
// {"seat", "n", "way", "dtype"} of each that has rows; besides, by the way "sockets", "counts" and the "number"
// under which the ranks have them (DataPort); by "shared-memory", "session", "memory", perhaps "counts", and "sockets"
// and "number" of the ranks that have them by socket. Rows by the way "endpoint" are in the options' slices.
PushOrder order_of(const OpenStep& step, const scene::Ledger& ledger);

}  // namespace rcb::net
