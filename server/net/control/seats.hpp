// SeatGroups: parallel solvers. A scene opened by M seats is pushed by all of them together: each contributes the
// particles it has, and the step is ordered once the last contribution is complete.
//
// Invariants
// 1. A seat belongs to one connection. A seat that takes its seat again does so with a higher generation; pushes and
//    slices from the older connection are refused or dropped from then on.
// 2. A step of the seats ends for all of them at once: it is ordered, or aborted with a message that names the seat
//    at fault.
// 3. A seat that lost its connection gets the report of the last step when it pushes that step again.
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
#include "server/net/push/engine.hpp"
#include "server/net/push/push.hpp"
#include "server/net/sockets/asio.hpp"
#include "server/net/sockets/connection.hpp"
#include "server/scene/ledger.hpp"
#include "server/scene/tally.hpp"

namespace rcb::net {

class Coordinator;
struct OpenPush;

struct SeatClaim {
  int seat = 0;
  int seats = 1;
  std::uint64_t generation = 0;  // 0: one above the seat's last generation
};

inline constexpr const char* kSeatsSession = "seats";  // of the steps of all seats together

wire::Json claim_json(const SeatClaim& claim);
// The claim that a scene.open asks for; nothing if it asks for none. Errors: invalid_argument.
Result<std::optional<SeatClaim>> read_claim(const wire::Json& request);

// A step that seats are pushing. An OpenPush without particles stands for it in the scene's gate.
struct SeatPush {
  SeatPush(asio::io_context& context, std::string of, std::int64_t number)
      : scene(std::move(of)), step(number), timer(context) {}
  std::string scene;
  std::int64_t step;
  std::vector<std::shared_ptr<OpenPush>> contributions;  // by seat; null: not begun
  std::size_t begun = 0;                                 // how many are begun
  std::size_t ready = 0;                                 // those before this one were ready when last looked at
  std::weak_ptr<OpenPush> front;                         // the OpenPush in the gate
  Timer timer;                                           // until the next notice to waiting seats
  TimePoint started = now();
  TimePoint end = TimePoint::max();
  bool ordered = false;
  bool over = false;  // every contribution is answered

  // Whether this connection has begun a contribution that isn't complete, so that its slices must come next.
  bool awaits(const Connection* connection) const;
  std::string progress() const;  // "2 of 4 seats"
  bool all_ready();
};

// A seat's push.begin.
struct ContributionBegin {
  PushId id;
  std::shared_ptr<Connection> connection;
  std::string client;
  std::uint64_t request = 0;
  wire::Json json;
  TimePoint end;
  std::shared_ptr<void> held;  // memory of a large request (Coordinator::hold_request)
};

// A seat's count.
struct CountBegin {
  std::string scene;
  std::int64_t step = 0;
  std::shared_ptr<Connection> connection;
  std::uint64_t request = 0;
  TimePoint end;
  std::optional<scene::CountRecord> record;
  std::uint64_t session = 0;  // session_key() of the record's
  Status fault;               // instead: what this seat found in its particles, for which the step fails for all
};

// A step that seats are counting.
struct SeatCount {
  SeatCount(asio::io_context& context, std::int64_t step, std::size_t seats)
      : tally(step, seats), waiting(seats), timer(context) {}
  scene::Tally tally;
  std::vector<std::optional<CountBegin>> waiting;  // by seat: who is answered at its end
  Timer timer;                                     // until the deadline or the next notice
  TimePoint started = now();
  TimePoint end = TimePoint::max();
  bool over = false;
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
  // Whether the connection holds a seat of the scene, or held one that a later generation has taken.
  bool knows(const std::string& scene, const Connection* connection) const;
  // What this connection has begun of the step; else null.
  std::shared_ptr<OpenPush> contribution_of(const SeatPush& step, const Connection* connection) const;
  // "4 seats" if any seat of the scene is taken; else "".
  std::string holders(const std::string& scene) const;
  // Errors: busy, if seats hold the scene, so that others may not push it.
  Status check_free(const std::string& scene) const;

  // Begins a contribution. The gate must hold no other push, and no change of the scene may be under way. A step that
  // is committed already is answered again. Errors: what is wrong with the push.begin.
  Status begin(ContributionBegin begin);
  // Takes a seat's count; answers all seats once the last one has come. No change of the scene may be under way.
  // Errors: what is wrong with this one; the others go on waiting.
  Status count(CountBegin begin);
  // To be called when all of a contribution has arrived.
  void contribution_whole(const std::shared_ptr<OpenPush>& contribution);
  // contribution: the one at fault; null: none is.
  void abort(const std::shared_ptr<SeatPush>& step, const OpenPush* contribution, const Status& why);
  // The error at a step's deadline: it names the missing seats.
  Status late(const SeatPush& step) const;
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
    std::shared_ptr<SeatCount> counting;  // null: no step is being counted
    std::vector<Seat> seats;
    // Of each connection that has a seat, or has lost it to a later generation and is still open.
    std::unordered_map<const Connection*, std::size_t> seat_by_connection;
  };

  static std::optional<std::size_t> seat_of(const Group& group, const Connection* connection);
  // json: its text.
  static Status send_to(const CountBegin& begin, const std::string& json);
  void open_count(const std::string& scene, std::int64_t step, Group& group);
  void decide(Group& group, scene::Ledger& ledger);
  static void close_count(Group& group, wire::FrameType type, const std::string& json);
  // Both end the counting, if there is any.
  static void answer_count(Group& group, const std::string& json);
  static void end_count(Group& group, const Status& why);
  std::string missing(const std::string& scene, const SeatCount& counting) const;
  awaitable<void> watch_count(std::shared_ptr<Coordinator> self, std::string scene,
                              std::shared_ptr<SeatCount> counting);
  Group* find(const std::string& scene);
  const Group* find(const std::string& scene) const;
  void abort_step_because_of(const std::string& scene, std::size_t seat, const std::string& why);
  std::string name(const std::string& scene, std::size_t seat) const;
  std::string missing(const SeatPush& step) const;
  std::string names_of(const std::string& scene, std::span<const std::size_t> seats) const;  // of eight, at most
  // Takes out a contribution that a newer attempt replaces.
  void withdraw(OpenPush& contribution);
  // When all seats have begun: what they bring must fit together. Errors: invalid_argument, not_conserved.
  Status check_together(const SeatPush& step) const;
  std::shared_ptr<SeatPush> open_step(const std::string& scene, std::int64_t step, const Group& group);
  void order(const std::shared_ptr<SeatPush>& step);
  void answered(const std::shared_ptr<SeatPush>& step, Answer answer);
  awaitable<void> watch(std::shared_ptr<Coordinator> self, std::shared_ptr<SeatPush> step);

  Coordinator& coordinator_;
  std::map<std::string, Group> groups_;
};

}  // namespace rcb::net
