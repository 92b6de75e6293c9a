// DataPlane: the direct path of pushes as the coordinator sees it. Clients bring each rank its slice themselves; the
// coordinator only tells the ranks which pushes to take and hears when they have them.
//
// Invariants
// 1. Every push.begin that names the direct path leads to exactly one open() or drop(); an open() to exactly one
//    order that takes the slices, or one drop().
// 2. After open() every rank that was told reports once: its slice is whole, or why it won't be. After drop() nothing
//    is awaited.
// Everything runs on rank 0's I/O thread.
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "server/net/push.hpp"

namespace rcb::net {

// What one rank is told of a push.
struct PushTicket {
  std::uint64_t number = 0;  // the service's own
  PushTerms terms;           // n: the particles of this rank alone
  bool share = false;        // of a member: ranks to which it brings nothing aren't told, and don't report
};

// What a rank says of its slice of a push.
struct SliceReport {
  std::uint64_t number = 0;  // of the push
  std::uint64_t bytes = 0;   // that have arrived
  bool whole = false;
  Status status;  // why it won't be whole
};

wire::Json report_json(const SliceReport& report);
SliceReport read_report(const wire::Json& json);
wire::Json ticket_json(const PushTicket& ticket, std::uint64_t count);
Result<PushTicket> read_ticket(const wire::Json& json);

class DataPlane {
 public:
  virtual ~DataPlane() = default;
  // counts: by rank.
  virtual void open(const PushTicket& ticket, std::span<const std::uint64_t> counts) = 0;
  virtual void drop(const PushId& id) = 0;
};

}  // namespace rcb::net
