// SeatGroups: the steps of a scene. Its seats bring each together, a block or a count each: the processes of a parallel
// solver, which have taken them, or one client that has taken none, which then is the only seat of its steps.
//
// Invariants
// 1. A seat belongs to one connection. A seat that takes its seat again does so with a higher generation; pushes and
//    slices from the older connection are refused or dropped from then on.
// 2. A step ends for all of its seats at once: it is ordered, or aborted with a message that names the seat at fault.
// 3. Who has brought the last step, and brings it again, gets its report.
// Everything runs on the I/O thread.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <unordered_map>
#include <vector>

#include "common/base/status.hpp"
#include "server/net/control/round.hpp"
#include "server/net/push/engine.hpp"
#include "server/net/push/push.hpp"
#include "server/scene/tally.hpp"

namespace rcb::net {

class Coordinator;
struct OpenStep;

struct SeatClaim {
  int seat = 0;
  int seats = 1;
  std::uint64_t generation = 0;  // 0: one above the seat's last generation
};

wire::Json claim_json(const SeatClaim& claim);
// The claim that a scene.open asks for; nothing if it asks for none. Errors: invalid_argument.
Result<std::optional<SeatClaim>> read_claim(const wire::Json& request);

// Who brings a step.
inline constexpr const char* kSeats = "seats";  // those who have taken the scene's; else the session of one client
struct Role {
  std::string by;
  std::size_t seat = 0;
  std::size_t seats = 1;
};

// What one seat brings of a step that is pushed, while it arrives.
struct Block : Asker {
  Block(asio::io_context& context, Asker of, PushTerms said)
      : Asker(std::move(of)), terms(std::move(said)), progress_check(context) {}
  PushTerms terms;
  std::optional<Slice> slice;  // through the endpoint: its rows, of which `charged_bytes` have come
  bool rows_missing = false;   // some of these are still to come
  std::shared_ptr<OpenStep> step;
  std::size_t seat = 0;
  wire::Json memory;  // the field, for the ranks
  Timer progress_check;
  bool given_up = false;
  std::uint64_t charged_bytes = 0;  // taken from the budget for the bytes that have arrived
  std::uint64_t progress_seen = 0;  // bytes at the last check
  // Where rows go to ranks' sockets only:
  std::uint64_t number = 0;                  // identifies the block; 0: none do
  std::vector<bool> whole;                   // by rank: its slice is complete
  std::vector<std::uint64_t> arrived_bytes;  // by rank, as far as it has reported

  bool ready() const;  // everything has arrived
  std::uint64_t bytes_arrived() const;
  std::string progress() const;
};

// A step that is being pushed. Until it is ordered it stands in the scene's gate.
struct OpenStep : Round<Block> {
  OpenStep(asio::io_context& context, const PushId& id, const Role& role)
      : Round(context, id.scene, id.step, role.seats), by(role.by) {}
  std::string by;         // Role::by
  std::size_t ready = 0;  // blocks before this one were ready when last looked at
  bool ordered = false;

  bool by_seats() const { return by == kSeats; }
  bool open() const { return !ordered && !over; }
  // The block that this connection has begun; else null.
  std::shared_ptr<Block> block_of(const Connection* connection) const;
  std::string who() const;       // "'anna'", or "4 seats"
  std::string progress() const;  // "2 of 4 seats"
  bool all_ready();
};

// A step that seats are counting, in the scene's gate until all have.
struct SeatCount : Round<Asker> {
  SeatCount(asio::io_context& context, const PushId& id, std::size_t seats)
      : Round(context, id.scene, id.step, seats), tally(seats) {}
  scene::Tally tally;
};

class SeatGroups {
 public:
  explicit SeatGroups(Coordinator& coordinator);

  // Takes a seat. Errors: busy (it is taken), invalid_argument (other terms than those of the other seats).
  Result<SeatClaim> join(const std::string& scene, SeatClaim wanted, const Connection* connection,
                         const std::string& client);
  // Frees the connection's seat and aborts a step that isn't ordered yet. why: completes the message, as "has closed
  // the scene".
  void leave(const std::string& scene, const Connection* connection, const std::string& why);
  void leave_all(const Connection* connection);
  // leave() for an open that failed: the generation that join() gave counts as never taken.
  void give_back_seat(const std::string& scene, const Connection* connection);
  // "4 seats" if any seat of the scene is taken; else "".
  std::string holders(const std::string& scene) const;
  // Errors: busy, if seats hold the scene, so that others may not push it.
  Status check_free(const std::string& scene) const;

  // The part of the connection in a step of the scene. Errors: busy, if others have taken its seats or have a step
  // open; aborted, if a later generation has taken the connection's seat.
  Result<Role> role_of(const PushId& id, const Connection* connection) const;
  // Begins a block, which is to get the rows of its slice if it has one. No change of the scene may be under way. Null:
  // the step is committed already, and answered again. Errors: those of role_of(), what is wrong with the push.
  // bulk_bytes: of its arrays.
  Result<std::shared_ptr<Block>> begin(const PushId& id, Asker asker, const wire::Json& push, std::uint64_t bulk_bytes);
  // Takes a seat's count; answers all seats once the last one has come. The scene is there, with no change under way.
  // Errors: those of role_of(), what is wrong with this one; the others go on waiting. counted: an error is what this
  // seat has found in its particles, with which the step fails for all.
  Status count(const PushId& id, Asker asker, Result<scene::CountRecord> counted);
  // To be called when all of a block has arrived.
  void block_whole(const Block& block);
  // Ends a step that isn't ordered; nothing was changed by it.
  void abort(OpenStep& step, const Status& why);
  // The same, by the fault of one block.
  void abort(const Block& block, const Status& why);
  void end_count(const std::string& scene, const Status& why);
  // To be called after every change of a scene.
  void scene_changed(const std::string& scene);

 private:
  struct Seat {
    std::string client;
    std::uint64_t generation = 0;            // 0: never taken
    std::uint64_t generation_before = 0;     // that of whoever had the seat before
    const Connection* connection = nullptr;  // null: free
  };
  struct Group {
    std::vector<Seat> seats;
    // Of each connection that has a seat, or has lost it to a later generation and is still open.
    std::unordered_map<const Connection*, std::size_t> seat_by_connection;
  };

  static std::optional<std::size_t> seat_of(const Group& group, const Connection* connection);
  // Whether the connection holds a seat of the scene, or held one that a later generation has taken.
  bool knows(const std::string& scene, const Connection* connection) const;
  // Ends the counting of the scene, if there is any; json: the text that all are told.
  void answer_count(const std::string& scene, wire::FrameType type, const std::string& json);
  // Until all have counted.
  void wait_for_counts(const std::shared_ptr<SeatCount>& counting);
  Group* find(const std::string& scene);
  const Group* find(const std::string& scene) const;
  void abort_step_because_of(const std::string& scene, std::size_t seat, const std::string& why);
  std::string name(const std::string& scene, std::size_t seat) const;
  std::string missing(const OpenStep& step) const;
  // At the deadline.
  void late(OpenStep& step);
  std::string names_of(const std::string& scene, std::span<const std::size_t> seats) const;  // of eight, at most
  // The step of which a block is to be one. Errors: aborted (a newer attempt is open), invalid_argument.
  Result<std::shared_ptr<OpenStep>> step_for(const PushId& id, const Role& role);
  // When all seats have begun: what they bring must fit together. Errors: invalid_argument, not_conserved.
  Status check_together(const OpenStep& step) const;
  // Ends the receiving: the scene's gate is free again.
  void close(OpenStep& step);
  void order(const std::shared_ptr<OpenStep>& step);
  void answered(OpenStep& step, Answer answer);

  Coordinator& coordinator_;
  std::map<std::string, Group> groups_;
};

}  // namespace rcb::net
