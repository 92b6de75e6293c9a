// Session: one client's connection, from welcome to goodbye. Requests are answered in order, one at a time.
//
// Invariants
// 1. Nothing but hello is understood before hello (Door), and only then a place is taken. A few who come when all are
//    taken are still served what the service's owner needs: status, scene.list, shutdown.
// 2. A breach of the protocol is answered where possible and ends this connection; nothing else is affected.
// 3. Every request has a deadline; a client that waits long is told what for.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <set>
#include <string>

#include "server/api/commands.hpp"
#include "server/net/coordinator.hpp"
#include "server/net/hello.hpp"

namespace rcb::net {

// The listener that a client came to.
struct Entrance {
  std::string endpoint;  // as clients name it
  std::shared_ptr<Door> door;
  std::shared_ptr<Lobby> late;  // who came when all places were taken
  bool files = false;           // its clients may have the service read and write files
};

class Session : public std::enable_shared_from_this<Session> {
 public:
  Session(std::shared_ptr<Coordinator> coordinator, Socket socket, Entrance entrance);
  ~Session();

  // Serves the client until it goes.
  awaitable<void> run();
  // Refuses a client that is one too many.
  awaitable<void> refuse(Status why);

  const std::shared_ptr<Connection>& connection() const { return connection_; }
  const std::string& client() const { return client_; }
  const std::string& number() const { return number_; }
  bool has_open(const std::string& scene) const { return open_.contains(scene); }
  const std::set<std::string>& open() const { return open_; }
  // Tells the client, after the answer it waits for, and closes when it is sent.
  void say_goodbye();

 private:
  struct Request {
    std::uint64_t number = 0;
    const api::CommandInfo* info = nullptr;
    std::string command;
    wire::Json json;
    double deadline_seconds = 0;
    TimePoint end;
    // Set once its client waits no longer: a long command may end early.
    std::shared_ptr<std::atomic<bool>> cancelled = std::make_shared<std::atomic<bool>>(false);
  };

  awaitable<Status> hello();
  // For this session, which has joined.
  bool place_is_free() const;
  // Why this client may not have this command; ok if it may.
  Status check_allowed(const Request& request);
  // The Status ends the session.
  awaitable<Status> serve(Frame frame);
  awaitable<void> dispatch(Request& request);
  bool answer_here(const Request& request);
  awaitable<void> scene_change(Request& request);
  awaitable<void> open_scene(Request& request);
  awaitable<void> shut_down(Request& request);
  awaitable<void> order_and_reply(Request& request, OrderOptions order);
  awaitable<void> reply_when_done(Request& request, std::shared_ptr<Pending> pending);
  void reply(const Request& request, Answer answer);

  awaitable<void> push_begin(Request& request);
  // The push.begin of a connection that has opened the scene as a member.
  awaitable<void> begin_share(Request& request, const PushId& id);
  // Opens the push's direct path, or, where only the service can answer it (a step that is committed), orders it.
  awaitable<void> begin_directly(std::shared_ptr<OpenPush> push);
  Result<std::shared_ptr<OpenPush>> admit_push(const Request& request, const PushId& id);
  Status push_conflict(const SceneGate& gate, const PushId& id);
  awaitable<Status> push_slice(Frame frame);
  // The bulk of a slice into its arrays. A push that ends meanwhile has its rest dropped.
  awaitable<Status> receive(const Frame& frame, const std::shared_ptr<OpenPush>& push, Slice& slice);
  awaitable<void> order_push(std::shared_ptr<OpenPush> push);

  // Waits until it is this request's turn at the scene and `ready` holds. Errors: deadline_exceeded, unavailable.
  // Where `at_once` holds, others' turns don't matter.
  awaitable<Status> wait_turn(
      const Request& request, const std::string& scene, std::function<bool()> ready,
      std::function<bool()> at_once = [] { return false; });
  // Sleeps until the timer is cancelled, the request's end, or the next notice (which it then sends).
  awaitable<void> nap(Timer& timer, const Request& request, TimePoint& notice_at, std::string what);

  void fail(std::uint64_t request, const Status& why);

  std::shared_ptr<Coordinator> coordinator_;
  std::shared_ptr<Connection> connection_;
  Entrance entrance_;
  std::optional<Lobby::Place> late_;  // came when all places were taken, and none has been free since
  std::string client_ = "a client that hasn't said hello";
  std::string number_;  // the client's session, 16 hex digits
  std::set<std::string> open_;
  bool asked_whether_gone_ = false;  // by a notice, once its end was closed
  int answering_ = 0;                // orders of this session that are on their way
  bool goodbye_due_ = false;         // to be said after its answer
};

}  // namespace rcb::net
