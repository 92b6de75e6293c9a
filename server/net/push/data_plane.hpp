// DataPlane: pushes to the ranks' sockets as the coordinator sees them. Clients send each rank its slice themselves;
// the coordinator only tells the ranks which pushes to receive, and hears when they have them.
//
// Invariants
// 1. Every push that names this way leads to exactly one open() or drop(); every open() leads to exactly
//    one order that takes the slices, or to one drop().
// 2. After open() every rank that was told reports once that its slice is complete, or why it won't be. After drop() no
//    report is awaited.
// Everything runs on rank 0's I/O thread.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "server/net/push/push.hpp"

namespace rcb::net {

// What one rank is told of such a push.
struct PushTicket {
  std::uint64_t number = 0;  // the push's number, given by the coordinator
  PushTerms terms;           // n: particles of this rank alone
};

// A rank's report on its slice of a push.
struct SliceReport {
  std::uint64_t number = 0;  // of the push
  std::uint64_t bytes = 0;   // arrived so far
  bool whole = false;
  Status status;  // why the slice won't be complete
};

wire::Json report_json(const SliceReport& report);
SliceReport read_report(const wire::Json& json);
wire::Json ticket_json(const PushTicket& ticket, std::uint64_t count);
Result<PushTicket> read_ticket(const wire::Json& json);

class DataPlane {
 public:
  virtual ~DataPlane() = default;
  // counts: by rank, of the slice's particles; ranks without one aren't told, and don't report.
  virtual void open(const PushTicket& ticket, std::span<const std::optional<std::uint64_t>> counts) = 0;
  virtual void drop(const PushId& id) = 0;
};

}  // namespace rcb::net
