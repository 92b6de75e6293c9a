// Session: one client's connection, from welcome to goodbye. Requests are answered in order, one at a time.
//
// Invariants
// 1. Nothing but hello is accepted before hello (Door), and the session takes a place only after it. When all places
//    are taken, a few more clients are still served what the service's owner needs: status, scene.list, shutdown.
// 2. A breach of the protocol is answered where possible and ends this connection; no other is affected.
// 3. Every request has a deadline; a client that waits long is told what it waits for.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <set>
#include <string>

#include "common/wire/count_record.hpp"
#include "server/api/commands.hpp"
#include "server/net/control/coordinator.hpp"
#include "server/net/sockets/hello.hpp"

namespace rcb::net {

// A place among those who wait at a scene, freed by the destructor.
class Place {
 public:
  Place(std::deque<Timer*>& among, asio::io_context& context) : among_(among), timer_(context) {
    among_.push_back(&timer_);
  }
  Place(const Place&) = delete;
  Place& operator=(const Place&) = delete;
  ~Place() { among_.erase(std::find(among_.begin(), among_.end(), &timer_)); }
  bool first() const { return among_.front() == &timer_; }
  Timer& timer() { return timer_; }

 private:
  std::deque<Timer*>& among_;
  Timer timer_;
};

// The listener through which a client came.
struct Entrance {
  std::string endpoint;  // the name by which clients know it
  std::shared_ptr<Door> door;
  std::shared_ptr<Lobby> late;  // for clients that come when all places are taken
  bool files = false;           // clients may have the service read and write files
};

class Session : public std::enable_shared_from_this<Session> {
 public:
  Session(std::shared_ptr<Coordinator> coordinator, Socket socket, Entrance entrance);
  ~Session();

  // Serves the client until it leaves.
  awaitable<void> run();
  // Refuses the client with `why` and ends the connection.
  awaitable<void> refuse(Status why);

  const std::shared_ptr<Connection>& connection() const { return connection_; }
  const std::string& client() const { return client_; }
  const std::string& number() const { return number_; }
  bool has_open(const std::string& scene) const { return open_.contains(scene); }
  const std::set<std::string>& open() const { return open_; }
  // Sends goodbye after the answer that is under way, then closes.
  void say_goodbye();

 private:
  struct Request {
    std::uint64_t number = 0;
    const api::CommandInfo* info = nullptr;
    std::string command;
    wire::Json json;
    double deadline_seconds = 0;
    TimePoint end;
    std::shared_ptr<void> held = nullptr;  // memory of a large request (Coordinator::hold_request)
    // Set when the client no longer waits, so that a long command may end early.
    std::shared_ptr<std::atomic<bool>> cancelled = std::make_shared<std::atomic<bool>>(false);
    Result<wire::CountRecord> counted = wire::CountRecord{};  // by a count
    std::uint64_t bytes = 0;                                  // of its frame
    std::optional<SeatClaim> seat = {};                       // that a scene.open has taken
    const Frame* unread = nullptr;                            // of a push: its arrays are still to be read
    bool opened = false;                                      // of a push: a block of its step
    Status breach = {};                                       // of the protocol: the session ends
  };

  awaitable<Status> hello();
  // Whether a place is free for this session, which has already joined.
  bool place_is_free() const;
  // Ok if this client may give this command; else why not.
  Status check_allowed(const Request& request);
  // Drops the fields that the command doesn't have; reserves memory for the rest if it is large. Errors: too_large,
  // busy.
  Status admit_size(Request& request, std::size_t bytes);
  OrderOptions options_of(const Request& request) const;
  // An error ends the session.
  awaitable<Status> serve(Frame frame);
  awaitable<void> dispatch(Request& request);
  bool answer_here(const Request& request);
  awaitable<void> scene_change(Request& request);
  awaitable<void> open_scene(Request& request);
  awaitable<void> shut_down(Request& request);
  awaitable<void> order_and_reply(Request& request, OrderOptions order);
  awaitable<void> reply_when_done(Request& request, std::shared_ptr<Pending> pending);
  void reply(const Request& request, Answer answer);

  // Reads the record of a count, of at most so many parts as its scene has, into `counted`. Errors end the session.
  awaitable<Status> read_record(const Frame& frame, Result<wire::CountRecord>& counted);
  awaitable<void> count(Request& request);
  Result<scene::CountRecord> record_of(Request& request) const;
  awaitable<void> answer_from_ledger(Request& request);
  // Waits until no change of the scene is under way. Errors: deadline_exceeded, unavailable.
  awaitable<Status> wait_settled(const Request& request, const std::string& scene);
  // A question about the positions of a when-needed scene waits for the next step, which then sends them, where others
  // step it. Errors: those of wait_settled.
  awaitable<Status> wait_for_positions(const Request& request);
  // Errors: invalid_argument, if the ranks hold an older step than the last one.
  Status check_positions(const std::string& scene) const;
  awaitable<Status> watch(const Request& request, const std::string& scene, std::function<bool()> done,
                          const std::string& what);

  Asker asker(const Request& request) const;
  awaitable<void> push(Request& request);
  // Whether a client that came by this endpoint may push this way. Errors: unsupported.
  Status check_way(const wire::Json& push) const;
  // Reads a push's arrays into its slice. If it is aborted meanwhile, the rest is read and dropped.
  awaitable<Status> receive(const Frame& frame, Block& block);
  // Reads what follows arrays that are checked. whose: "a slice". Errors: protocol_error.
  awaitable<Status> check_sum(const Frame& frame, const wire::BulkChecksum& checksum, const char* whose);
  // Waits until this request is first in the scene's queue and `ready` holds, or until `overtake` holds, whoever is
  // first. Errors: deadline_exceeded, unavailable.
  awaitable<Status> wait_turn(
      const Request& request, const std::string& scene, std::function<bool()> ready,
      std::function<bool()> overtake = [] { return false; });
  // Sleeps until the timer is cancelled, the request's deadline, or the next notice, which it then sends.
  awaitable<void> nap(Timer& timer, const Request& request, TimePoint& notice_at, std::string what);

  void fail(std::uint64_t request, const Status& why);
  // Of a push that was not opened: what it brings the ranks.
  void drop_slices(const wire::Json& push);

  std::shared_ptr<Coordinator> coordinator_;
  std::shared_ptr<Connection> connection_;
  Entrance entrance_;
  std::optional<Lobby::Place> late_;  // set while it is served although all places were taken when it came
  std::string client_ = "a client that hasn't said hello";
  std::string number_;  // session id, 16 hex digits
  std::set<std::string> open_;
  bool asked_whether_gone_ = false;  // a notice was sent to find out whether the peer still reads
  int answering_ = 0;                // orders of this session that aren't answered
  bool goodbye_due_ = false;         // goodbye waits for the answer under way
};

}  // namespace rcb::net
