// Coordinator: what all sessions share. It puts commands into one order and says who may have which scene.
//
// Invariants
// 1. At most `orders_max` orders are unfinished, more than there can be sessions, and of their requests
// wire::kOrderBytesMax;
//    busy is said before ordering, never after.
// 2. A scene has one open push at most. Commands that change a scene wait for its end; what comes later waits behind
//    them, first come, first served (SceneGate::queue).
// 3. The snapshot shows what the last order that was answered has done, before that answer leaves.
// 4. What has arrived of the arrays of open and unfinished pushes has about `bulk_bytes_max` bytes at most; what is
//    only announced takes nothing from others. An open push must go on arriving (kProgressBytes in `frame_seconds`).
// 5. What an order has taken is given back when it ends, however it ends (Coordinator::Unfinished).
// Everything runs on the I/O thread.
#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "common/base/status.hpp"
#include "server/net/asio.hpp"
#include "server/net/connection.hpp"
#include "server/net/control.hpp"
#include "server/net/data_plane.hpp"
#include "server/net/engine.hpp"
#include "server/net/members.hpp"
#include "server/net/push.hpp"

namespace rcb::net {

class Session;

// What an open push must bring, at least, in `frame_seconds`.
inline constexpr std::uint64_t kProgressBytes = std::uint64_t{64} << 10U;

// A push that is being received.
struct OpenPush {
  OpenPush(asio::io_context& context, PushTerms terms) : slices(std::move(terms)), deadline(context) {}
  PushSlices slices;
  std::shared_ptr<Connection> connection;  // whose it is
  std::string client;
  std::uint64_t request = 0;  // of its push.begin
  wire::Json begin;
  TimePoint started = now();
  TimePoint end;
  Timer deadline;
  bool given_up = false;
  bool closed = false;              // given up, or ordered: the scene's gate is free
  std::uint64_t charged_bytes = 0;  // of the budget: what has arrived
  std::uint64_t progress_seen = 0;  // at the last look
  TimePoint look_at;                // when it must have gone on
  // On the direct path:
  std::uint64_t number = 0;                  // 0: not on it
  std::vector<bool> whole;                   // by rank
  std::vector<std::uint64_t> arrived_bytes;  // by rank, as far as they have said
  std::function<void()> when_whole;          // all ranks have their slices
  // Of a parallel solver: the step that this is a member's share of, or (-1), in the gate, stands for.
  std::shared_ptr<MemberPush> together;
  int member = -1;

  bool ready() const;  // nothing of it is still to come
  std::uint64_t bytes_arrived() const;
  std::string progress() const;
};

struct SceneGate {
  std::shared_ptr<OpenPush> push;
  int changes_unfinished = 0;  // ordered commands that change the scene
  std::deque<Timer*> queue;    // who waits for a turn
  void wake() {
    for (Timer* timer : queue) timer->cancel();
  }
};

// An order's answer, once it is there.
struct Pending {
  explicit Pending(asio::io_context& context) : signal(context, TimePoint::max()) {}
  std::optional<Answer> answer;
  Timer signal;  // cancelled when it is
};

struct OrderOptions {
  std::vector<Slice> slices;
  double received_seconds = 0;
  double deadline_seconds = 60;
  std::string changes;                           // the scene it changes; empty: none
  std::uint64_t charged_bytes = 0;               // given back when it is answered
  std::shared_ptr<std::atomic<bool>> cancelled;  // of one that may be given up while it is executed; else null
  std::function<void(Answer)> then;              // gets the answer at once; nobody waits for it
};

class Coordinator : public std::enable_shared_from_this<Coordinator> {
 public:
  Coordinator(asio::io_context& context, ControlOptions options, Engine& engine);

  const ControlOptions& options() const { return options_; }
  // Names this run of the service: 16 hex digits, others at every start.
  const std::string& instance() const { return instance_; }
  asio::io_context& context() { return context_; }
  const api::Snapshot& snapshot() const { return snapshot_; }
  bool shutting_down() const { return shutting_down_; }
  std::size_t session_count() const { return sessions_.size(); }
  // The memory that an answer takes until it is sent, given back with the result. Errors: busy, where those of clients
  // that don't read take all there is.
  Result<std::shared_ptr<void>> hold_answer(std::uint64_t bytes);
  void memory_reported(int rank, std::uint64_t bytes) { memory_bytes_.at(static_cast<std::size_t>(rank)) = bytes; }
  // Before the loop starts: who knows which ranks say nothing.
  void ask_for_silence(std::function<std::vector<SilentRank>()> ask) { silent_ranks_ = std::move(ask); }
  // What an unfinished order waits for: "the engine", or the ranks that say nothing.
  std::string engine_in_words() const;
  void add_endpoint(std::string endpoint) { endpoints_.push_back(std::move(endpoint)); }

  void join(Session* session) { sessions_.insert(session); }
  // Gives up the session's pushes.
  void leave(Session* session);

  // Errors: busy, too_large, unavailable.
  Result<std::shared_ptr<Pending>> order(wire::Json request, OrderOptions order);

  // Gates stay where they are while anyone waits in them.
  SceneGate& gate(const std::string& scene) { return gates_[scene]; }
  void tidy(const std::string& scene);

  // Starts the push's deadline. The gate must be free.
  std::shared_ptr<OpenPush> open_push(PushTerms terms, std::shared_ptr<Connection> connection, std::string client,
                                      double deadline_seconds);
  // At this moment the push is given up, and before it if it stops arriving. Replaces what was said before.
  void arm(const std::shared_ptr<OpenPush>& push, TimePoint end);
  // So many more bytes of the push have arrived. Where that is too much the push is given up.
  void charge(const std::shared_ptr<OpenPush>& push, std::uint64_t bytes);
  void give_back(OpenPush& push) { charged_bytes_ -= std::exchange(push.charged_bytes, 0); }
  MemberGroups& groups() { return groups_; }
  // The open push, or share of one, with this id, if this connection opened it.
  std::shared_ptr<OpenPush> find_push(const PushId& id, const Connection* connection);
  // Tells the ranks to take the slices of a push, or share of one, that goes directly. When all have them when_whole is
  // called, or the members' groups are told.
  void receive_directly(const std::shared_ptr<OpenPush>& push);
  void slice_reported(int rank, const SliceReport& report);
  // The ranks drop what comes for a push that will not be opened.
  void refuse_directly(const PushId& id);
  void serve_data(DataPlane& plane, const std::string& endpoint, std::vector<std::string> addresses);
  // The ranks' data addresses for clients of this endpoint; empty: there is no direct path.
  const std::vector<std::string>& data_addresses(const std::string& endpoint) const;

  // Ends the push and tells its client why. Nothing was ordered, so nothing has changed.
  void give_up(std::shared_ptr<OpenPush> push, const Status& why);  // by value: the gate's own is let go
  // Ends the receiving: the push's bytes are now the order's.
  void close_push(std::shared_ptr<OpenPush> push);

  // Clients with the scene open, by name; `except`: sessions of this number are left out.
  std::vector<std::string> members(const std::string& scene, const std::string& except = {}) const;
  Status unknown_scene(const std::string& scene) const;

  wire::Json status_json() const;
  wire::Json silent_json() const;
  wire::Json scenes_json() const;

  // Orders the end: open pushes and what only asks are given up, what changes a scene is still done where it has begun.
  // `told` runs when all ranks have agreed, before every session gets its goodbye.
  void shut_down(const std::string& why, std::function<void()> told);

 private:
  // The open push, or share of one, of this number.
  std::shared_ptr<OpenPush> find_push(std::uint64_t number) const;
  // What an order has taken: its place among the unfinished, its scene's gate, bytes of the budget.
  class Unfinished;
  void complete(Answer answer, const std::shared_ptr<Unfinished>& unfinished, const std::shared_ptr<Pending>& pending);
  void watch_arrival(const std::shared_ptr<OpenPush>& push);
  // What is late, ends: the push, or the members' step that it is of.
  void give_up_late(const std::shared_ptr<OpenPush>& push, const Status& why);
  void say_goodbye();
  wire::Json log_json() const;

  asio::io_context& context_;
  ControlOptions options_;
  std::string instance_;
  Engine& engine_;
  DataPlane* data_ = nullptr;
  std::map<std::string, std::vector<std::string>> data_addresses_;  // by endpoint
  std::uint64_t pushes_numbered_ = 0;
  api::Snapshot snapshot_;
  std::set<Session*> sessions_;
  MemberGroups groups_{*this};
  std::map<std::string, SceneGate> gates_;
  std::vector<std::string> endpoints_;
  std::function<std::vector<SilentRank>()> silent_ranks_;
  std::vector<std::uint64_t> memory_bytes_;  // by rank, as each said it last; 0: not yet
  std::vector<std::function<void()>> told_;
  std::uint64_t charged_bytes_ = 0;
  std::shared_ptr<std::uint64_t> answer_bytes_ = std::make_shared<std::uint64_t>(0);  // not yet sent
  std::set<Unfinished*> unfinished_;
  int orders_unfinished_ = 0;
  std::uint64_t order_bytes_unfinished_ = 0;  // of their requests
  bool shutting_down_ = false;
  bool ended_ = false;
  TimePoint started_ = now();
  std::filesystem::file_time_type started_on_disk_ = std::filesystem::file_time_type::clock::now();
};

}  // namespace rcb::net
