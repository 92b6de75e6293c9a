// Coordinator: what all sessions share. It puts all commands into one order and decides which session may change a
// scene.
//
// Invariants
// 1. At most `orders_max` orders are unfinished, which is more than there can be sessions, and large requests have at
//    most wire::kLargeRequestBytesMax bytes together. A command beyond that is refused (busy) before it is ordered,
//    never after.
// 2. A scene has at most one open step. Commands that change the scene wait for its end; later pushes and commands
//    queue behind them, first come, first served (SceneGate::queue).
// 3. The ledger has taken in what an order has done before its answer is sent.
// 4. The arrays of open and unfinished pushes have about `bulk_bytes_max` bytes at most. Only bytes that have arrived
//    count: a push that is merely announced takes nothing from others. An open push must go on arriving (kProgressBytes
//    in `frame_seconds`).
// 5. What an order has reserved is released when the order ends, however it ends (Coordinator::OrderReservation).
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
#include <string_view>
#include <unordered_map>
#include <utility>
#include <vector>

#include "common/base/status.hpp"
#include "server/net/control/control.hpp"
#include "server/net/control/seats.hpp"
#include "server/net/push/data_plane.hpp"
#include "server/net/push/engine.hpp"
#include "server/net/push/push.hpp"
#include "server/net/sockets/asio.hpp"
#include "server/net/sockets/connection.hpp"
#include "server/scene/ledger.hpp"

namespace rcb::net {

class Session;

// An open push that brings less than this in `frame_seconds` is given up.
inline constexpr std::uint64_t kProgressBytes = std::uint64_t{64} << 10U;

// Limits the memory of one kind of data that is on its way.
class ByteBudget {
 public:
  explicit ByteBudget(std::uint64_t max) : max_(max) {}
  // Reserves the bytes until the result is released; null if they don't fit. The first to come may have any size.
  std::shared_ptr<void> take(std::uint64_t bytes) {
    if (*taken_ > 0 && bytes > max_ - std::min(*taken_, max_)) return nullptr;
    *taken_ += bytes;
    return {taken_.get(), [taken = taken_, bytes](void*) { *taken -= bytes; }};
  }
  std::uint64_t taken() const { return *taken_; }

 private:
  std::uint64_t max_;
  std::shared_ptr<std::uint64_t> taken_ = std::make_shared<std::uint64_t>(0);
};

struct SceneGate {
  std::shared_ptr<OpenStep> step;       // that is being pushed; null: none
  std::shared_ptr<SeatCount> counting;  // a step of which some seats' counts have come
  int changes_unfinished = 0;           // ordered, unfinished commands that change the scene
  std::deque<Timer*> queue;             // the requests that wait for their turn
  std::deque<Timer*> watching;          // requests that wait for what others do, and keep nobody waiting
  void wake() {
    for (Timer* timer : queue) timer->cancel();
    for (Timer* timer : watching) timer->cancel();
  }
};

// Holds an order's answer once there is one.
struct Pending {
  explicit Pending(asio::io_context& context) : signal(context, TimePoint::max()) {}
  std::optional<Answer> answer;
  Timer signal;  // cancelled when the answer is there
};

struct OrderOptions {
  std::vector<Slice> slices;
  double received_seconds = 0;
  double deadline_seconds = 60;
  bool restores = false;                         // at the start, when nobody else orders: any number may be unfinished
  std::vector<std::uint64_t> sessions;           // of a push: the key of each seat's
  std::string changes;                           // name of the scene that the order changes; empty: none
  std::uint64_t charged_bytes = 0;               // released when the order is answered
  std::shared_ptr<std::atomic<bool>> cancelled;  // set to end the order early; null: it can't be
  std::shared_ptr<void> held;                    // memory of a large request (Coordinator::hold_request)
  std::function<void(Answer)> then;              // gets the answer at once, instead of a Pending
};

// Clients that have a scene open. Some are named, so that the scenes of all clients fit into an answer.
struct Holders {
  static constexpr std::size_t kNamed = 8;
  std::size_t count = 0;
  std::vector<std::string_view> first;  // in alphabetical order, of sessions that are there

  void add(std::string_view name);
  std::string in_words() const;  // "a, b and 3 more"
};

class Coordinator : public std::enable_shared_from_this<Coordinator> {
 public:
  Coordinator(asio::io_context& context, ControlOptions options, Engine& engine);

  const ControlOptions& options() const { return options_; }
  // Identifies this run of the service: 16 hex digits, different at every start.
  const std::string& instance() const { return instance_; }
  asio::io_context& context() { return context_; }
  const scene::Ledgers& scenes() const { return scenes_; }
  scene::Ledgers& scenes() { return scenes_; }
  // Before anybody is let in: the scenes of an earlier service, without their particles.
  void restore_scenes();
  // Has the scene's next step bring its positions, for a question; at most once a second.
  void want_positions(const std::string& scene);
  bool shutting_down() const { return shutting_down_; }
  std::size_t session_count() const { return sessions_.size(); }
  // Reserves the memory of an answer until it is sent; letting go of the result releases it. Errors: busy, if answers
  // to clients that don't read them take all of the budget.
  Result<std::shared_ptr<void>> hold_answer(std::uint64_t bytes);
  // Reserves memory for the JSON of a large request; released with the result. Errors: busy.
  Result<std::shared_ptr<void>> hold_request(std::uint64_t bytes);
  void memory_reported(int rank, std::uint64_t bytes) { memory_bytes_.at(static_cast<std::size_t>(rank)) = bytes; }
  // Before the loop starts: `ask` returns the ranks that have gone silent.
  void set_silence_query(std::function<std::vector<SilentRank>()> ask) { silent_ranks_ = std::move(ask); }
  // What unfinished orders wait for, in words: "the engine", or the silent ranks.
  std::string engine_in_words() const;
  // encrypted: towards other machines.
  void add_endpoint(std::string endpoint, bool encrypted) {
    endpoints_.push_back(std::move(endpoint));
    encryption_.push_back(encrypted ? "TLS 1.3" : "none");
  }

  void join(Session* session) { sessions_.insert(session); }
  // Removes the session and aborts its pushes.
  void leave(Session* session);

  // Errors: busy, too_large, unavailable.
  Result<std::shared_ptr<Pending>> order(wire::Json request, OrderOptions order);
  // Sets the flag of an order whose answer nobody waits for any more.
  void cancel(std::atomic<bool>& cancelled);

  // The reference stays valid while a push, a change or a queued request uses the gate; the functions below erase
  // others.
  SceneGate& gate(const std::string& scene) { return gates_[scene]; }
  void erase_gate_if_unused(const std::string& scene);
  void wake_queue(const std::string& scene);

  // The block's step is aborted if the block stops arriving.
  void watch_arrival(const std::shared_ptr<Block>& block);
  // Counts `bytes` more of the block as arrived. Aborts its step if the budget of all pushes is exceeded.
  void charge(Block& block, std::uint64_t bytes);
  // Nothing of it is taken any more.
  void give_up(Block& block);
  SeatGroups& groups() { return groups_; }
  // Tells the ranks that get rows of a block by their sockets to receive them; SeatGroups::block_whole() when all have
  // theirs.
  void receive_directly(const std::shared_ptr<Block>& block);
  void slice_reported(int rank, const SliceReport& report);
  // Tells the ranks to drop the slices of a push that will not be opened.
  void refuse_directly(const PushId& id);
  // Whether this very push is open, of which another was refused: the ranks need what it brings.
  bool has_open(const PushId& id) const;
  void serve_data(DataPlane& plane, const std::string& endpoint, std::vector<std::string> addresses);
  // The addresses, by rank, of the data listeners for clients of this endpoint; empty: there are none.
  const std::vector<std::string>& data_addresses(const std::string& endpoint) const;
  void serve_this_machine(std::vector<LocalAddress> addresses) { local_addresses_ = std::move(addresses); }
  // By rank: its data listener for clients on its own machine.
  const std::vector<LocalAddress>& local_addresses() const { return local_addresses_; }

  // Sessions with the number `except` are left out.
  Holders holders(const std::string& scene, const std::string& except = {}) const;
  Status unknown_scene(const std::string& scene) const;

  // Finds out whether the log is this service's, for status_json(); returns after a moment where the disk doesn't
  // answer.
  awaitable<void> look_at_log();
  wire::Json status_json() const;
  wire::Json silent_json() const;
  wire::Json unfinished_json() const;
  wire::Json hosts_json() const;
  wire::Json scenes_json() const;

  // Orders the end of the service: open pushes are aborted, orders already submitted are still executed. `told` runs
  // when all ranks have agreed to end, before the sessions say goodbye.
  void shut_down(const std::string& why, std::function<void()> told);

 private:
  // What an order has reserved: its place among the unfinished orders, its scene's gate, bytes of the budget.
  class OrderReservation;
  void take_change(Answer& answer);
  void complete(Answer answer, const std::shared_ptr<OrderReservation>& unfinished,
                const std::shared_ptr<Pending>& pending);
  void say_goodbye();

  asio::io_context& context_;
  ControlOptions options_;
  std::string instance_;
  Engine& engine_;
  ByteBudget answers_;         // not yet sent
  ByteBudget large_requests_;  // not yet answered
  DataPlane* data_ = nullptr;
  std::map<std::string, std::vector<std::string>> data_addresses_;  // by endpoint
  std::vector<LocalAddress> local_addresses_;
  std::uint64_t pushes_numbered_ = 0;
  std::unordered_map<std::uint64_t, std::shared_ptr<Block>> receiving_;  // by number: ranks wait for their rows
  scene::Ledgers scenes_;
  scene::Restored restored_;
  std::map<std::string, TimePoint> positions_wanted_;  // when a question last had a scene's positions sent
  std::set<Session*> sessions_;
  SeatGroups groups_{*this};
  std::map<std::string, SceneGate> gates_;
  std::vector<std::string> endpoints_;
  std::vector<std::string> encryption_;  // of each endpoint
  std::function<std::vector<SilentRank>()> silent_ranks_;
  std::vector<std::uint64_t> memory_bytes_;  // by rank, as last reported; 0: not yet
  std::vector<std::function<void()>> shutdown_callbacks_;
  std::uint64_t charged_bytes_ = 0;
  std::set<OrderReservation*> unfinished_;
  bool shutting_down_ = false;
  bool ended_ = false;
  TimePoint started_ = now();
  std::filesystem::file_time_type started_on_disk_ = std::filesystem::file_time_type::clock::now();
  std::string log_path_;             // as last found; empty: there is none of this service
  std::shared_ptr<Timer> log_look_;  // set while the log file is being looked at: those who ask wait for it
};

}  // namespace rcb::net
