// PushOrder: the order "push" to the ranks, which the blocks of a step make together: that of one client, or those of
// all seats.
#pragma once

#include <memory>
#include <span>

#include "server/net/control/coordinator.hpp"

namespace rcb::net {

struct PushOrder {
  wire::Json request;
  OrderOptions options;
};

// Takes what has arrived of the pushes. seats: of the scene, whose pushes these are by number; 0: one client's.
//
// The request has the fields of push.begin of all blocks together, "seats", "terms" (of the decision), "counted_ids"
// (where counts have brought other particles than the ranks hold: the sum of their ids) and "blocks":
// {"seat", "n", "path", "dtype"} of each that has rows; besides, with the path "direct", "counts" and the "number"
// under which the ranks have them (DataPort); with "shared", "session", "memory", perhaps "counts", and "sockets" and
// "number" of the ranks that have them by socket. Rows by the path "gateway" are in the options' slices.
PushOrder order_of(std::span<const std::shared_ptr<OpenPush>> pushes, std::size_t seats, const scene::Ledger& ledger);

}  // namespace rcb::net
