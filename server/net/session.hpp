// Session: one client's connection, from welcome to goodbye. Requests are answered in order, one at a time.
//
// Invariants
// 1. Nothing but hello is understood before hello, which has its own small limits.
// 2. A breach of the protocol is answered where possible and ends this connection; nothing else is affected.
// 3. Every request has a deadline; a client that waits long is told what for.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <set>
#include <string>

#include "server/api/commands.hpp"
#include "server/net/coordinator.hpp"

namespace rcb::net {

class Session : public std::enable_shared_from_this<Session> {
 public:
  // endpoint: the listener that the client came to.
  Session(std::shared_ptr<Coordinator> coordinator, Socket socket, std::string endpoint, bool with_token);
  ~Session();

  // Serves the client until it goes.
  awaitable<void> run();
  // Refuses a client that is one too many.
  awaitable<void> refuse(Status why);

  const std::shared_ptr<Connection>& connection() const { return connection_; }
  const std::string& client() const { return client_; }
  const std::string& number() const { return number_; }
  bool has_open(const std::string& scene) const { return open_.contains(scene); }
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
  Status check_hello(const Frame& frame);
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
  std::string endpoint_;
  bool with_token_;
  std::string client_ = "a client that hasn't said hello";
  std::string number_;  // the client's session, 16 hex digits
  std::set<std::string> open_;
  int answering_ = 0;         // orders of this session that are on their way
  bool goodbye_due_ = false;  // to be said after its answer
};

}  // namespace rcb::net
