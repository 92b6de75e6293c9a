// IncomingSlices: the pushes that the coordinator has opened, whose slices are being received, and their memory.
//
// Invariants
// 1. Memory is reserved when a push is opened, of the size that the coordinator has admitted; the kernel provides pages
//    as bytes arrive.
// 2. An opened push ends with one report: the slice is complete, or why it won't be. Reports before that say how many
//    bytes have come.
// Everything runs on the I/O thread.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/base/status.hpp"
#include "server/api/spare_memory.hpp"
#include "server/net/push/data_plane.hpp"
#include "server/net/sockets/connection.hpp"

namespace rcb::net {

struct Incoming {
  PushTicket ticket;
  std::vector<Buffer<std::byte>> arrays;   // each of the whole slice's size
  std::uint64_t have = 0;                  // particles complete so far
  const Connection* connection = nullptr;  // the one that brings the slice
  std::uint64_t connection_bytes = 0;      // received on it before this slice
  std::uint64_t told_bytes = 0;            // bytes of the slice reported so far
  bool over = false;                       // reported or dropped
};

class IncomingSlices {
 public:
  using Report = std::function<void(const SliceReport& report)>;

  IncomingSlices(int rank, std::shared_ptr<api::SpareMemory> spare) : rank_(rank), spare_(std::move(spare)) {}
  void set_report(Report report) { report_ = std::move(report); }

  void open(PushTicket ticket);
  void drop(const PushId& id);
  // Null if there is no such push.
  std::shared_ptr<Incoming> find(const PushId& id) const;
  // Ends a push that hasn't ended yet; ok: its slice is complete.
  void end(const std::shared_ptr<Incoming>& push, const Status& status);
  // Ends the pushes whose slices this connection was bringing.
  void lose(const Connection& connection, const std::string& why);
  // Reports the bytes that have come if they are at least `more` above the last report.
  void tell(Incoming& push, std::uint64_t more);
  void tell_all();
  // The slice of the order's push, if there is any.
  std::optional<Slice> take(std::uint64_t number);

  // Of the pushes that have ended, the latest are remembered.
  void remember_ended(const PushId& id);
  bool has_ended(const PushId& id) const { return ended_.contains(id); }

 private:
  int rank_;
  std::shared_ptr<api::SpareMemory> spare_;
  Report report_;
  void forget(const Incoming& push);

  std::map<std::uint64_t, std::shared_ptr<Incoming>> pushes_;  // by the push's number
  std::map<PushId, std::uint64_t> numbers_;                    // of these; of two with one id the latest's
  std::set<PushId> ended_;
  std::deque<PushId> ended_in_turn_;  // in order; may name pushes that were opened again since
};

}  // namespace rcb::net
