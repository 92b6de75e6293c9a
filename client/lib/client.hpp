// The C++ client: connect, create a scene, push positions every step.
//
//   auto client = rcb::client::Client::connect({});
//   client->create_scene("jet", {.parts = 8, .replace = true});
//   auto scene = client->open_scene("jet");
//   auto result = scene->step(rcb::client::Positions::rows(xyz.data(), n, 3));
//
// A lost service is reached again, within the call's deadline: a connection that was cut, and a service that died and
// was started again. Reads are repeated by themselves, and so is a step, which the service applies once; a scene that
// died with its service is made anew, and the step brings all particles (StepReport::scene_recreated). Other commands
// that were cut off fail with `unavailable`: whether they took effect is for the caller to ask. Thread-safety: a Client
// and its Scenes belong to one thread at a time. No call waits without a deadline. Faults come back as Status: code,
// message, hint.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/base/status.hpp"

namespace rcb::client {

// How positions travel: straight to the ranks, or all through the endpoint. automatic: large pushes directly where the
// ranks' own addresses answer. The environment's RCBD_PATH (auto, direct, gateway) decides where the caller doesn't.
enum class Path { automatic, direct, gateway };

struct ConnectOptions {
  std::string endpoint;  // unix:PATH or HOST:PORT; empty: RCBD_ENDPOINT, else the default socket, else 127.0.0.1:7470
  double deadline_seconds = 5;  // for connecting and saying hello
  std::string name = "rcb client";
  // TCP only; empty: RCBD_TOKEN, else the file RCBD_TOKEN_FILE, else, on this machine, found in the service's data
  // directory.
  std::string token;
  Path path = Path::automatic;
  // Told what a call waits for, as the service says it, or of a service that has gone; may be empty.
  std::function<void(const std::string&)> on_notice;
  // Once connected, calls wait for a service that has gone, until their deadline, and make a lost scene anew. Otherwise
  // one new connection is tried, and a lost scene is an error.
  bool outlive = true;
};

struct SceneOptions {
  int parts = 1;
  int dims = 3;
  std::string method = "rcb";
  double tolerance = 0.1;  // >= 0; infinity forbids automatic repartitions
  double axis_hysteresis = 1.2;
  double cut_tolerance = 0;          // 0 to 1: how far from its target a search for cuts may leave a part; 0: exact
  std::string policy = "tolerance";  // or "cost": repartition when imbalance has cost more than that takes
  std::string recut = "all";         // or "subtree": a repartition cuts no more than the error makes necessary
  std::vector<double> part_sizes;
  bool replace = false;
};

// A view of n positions in the caller's memory; nothing is copied before the send.
struct Positions {
  std::array<const double*, 3> axis{};  // first element of each axis
  std::size_t stride = 1;               // doubles from one particle to the next
  std::size_t count = 0;
  int dims = 3;
  // Where the solver keeps its arrays in the plan's order: by_rank[r][a] is axis a of rank r's particles, slot by slot.
  std::span<const std::array<const double*, 3>> by_rank;
  std::uint64_t plan_version = 0;  // of that plan
  // Instead of `axis` and `by_rank`, where the solver has float32: they travel as they are, half the bytes, and count
  // as the doubles that they are exactly.
  std::array<const float*, 3> axis_f4{};
  std::span<const std::array<const float*, 3>> by_rank_f4;

  // xyz: [count][dims], C order.
  static Positions rows(const double* xyz, std::size_t count, int dims);
  // One contiguous array an axis, each [count].
  static Positions axes(std::span<const double* const> axes, std::size_t count);
  // In the order of Scene::plan(): nothing is gathered or copied before the send. `ranks` must outlive the call of
  // step.
  static Positions in_plan_order(std::span<const std::array<const double*, 3>> ranks, std::uint64_t plan_version,
                                 std::size_t count, int dims);
  // The same of float32.
  static Positions rows(const float* xyz, std::size_t count, int dims);
  static Positions axes(std::span<const float* const> axes, std::size_t count);
  static Positions in_plan_order(std::span<const std::array<const float*, 3>> ranks, std::uint64_t plan_version,
                                 std::size_t count, int dims);

  bool single() const;         // float32
  bool in_plan_order() const;  // by_rank or by_rank_f4
};

// Particles that a step adds.
struct Insertion {
  Positions positions;                // [count], in rows or axes; double or float32 as those of the step
  std::span<const std::int64_t> ids;  // [count], distinct, not in the scene; empty: the service chooses them
  std::span<const double> weights;    // [count] if the scene has weights, else empty
};

struct StepReport {
  std::string scene;
  std::int64_t step = 0;
  std::uint64_t epoch = 0;
  std::uint64_t n = 0;
  int parts = 0;  // may change between two steps: another client's rebalance
  // The service had lost the scene; it was made anew, and this step brought all particles. The cuts are those of a
  // first partition.
  bool scene_recreated = false;
  std::optional<double> error_before;  // none at the first push
  double error = 0;
  double imbalance = 1;
  bool repartitioned = false;
  std::string reason;
  int axes_flipped = 0;
  std::uint64_t drifted = 0;
  std::uint64_t moved = 0;
  std::uint64_t migrated = 0;
  std::uint64_t inserted = 0;
  std::uint64_t removed = 0;
  std::optional<std::int64_t> first_id;  // of the inserted, where the service chose their ids: they are consecutive
  std::uint64_t scanned = 0;             // particles whose positions came
  std::uint64_t searched = 0;            // particles that a search for cuts looked at
  std::uint64_t rounds = 0;              // of the search for cuts; 0: none
  std::uint64_t reductions = 0;          // its collectives
  std::vector<std::string> skipped;
  std::uint64_t bytes = 0;
  double seconds_receive = 0, seconds_exchange = 0, seconds_search = 0, seconds_migrate = 0, seconds_total = 0;
  std::string json;  // the report as the service sent it
};

// Which of a scene's step reports: all; the first so many; the last so many; of the last so many the first so many.
struct HistoryRange {
  std::optional<std::uint64_t> first;
  std::optional<std::uint64_t> last;
};

struct HistoryRead {
  std::uint64_t from = 0;  // the number of the first, counted from the scene's first step
  std::uint64_t reports = 0;
  std::uint64_t lost = 0;  // of that range: the service's disk could not take or give them back
  std::string loss;        // why
};

struct PartChange {
  std::uint64_t row;  // index into the caller's arrays
  std::int32_t part;
};

struct StepOptions {
  std::optional<std::int64_t> step;  // default: the last step + 1, 0 at first
  // [count], distinct, >= 0; empty: 0..count-1. At the scene's first push, and at the first step of a Scene that was
  // opened when it had ids of its own; later they may be left out.
  std::span<const std::int64_t> ids;
  std::span<const double> weights;  // [count]; empty: none, or unchanged
  // What the solver computed since its last push, on its slowest process; a scene of the policy "cost" decides by it.
  std::optional<double> step_seconds;
  // Rows that moved since this Scene's last step, distinct, in any order; all others stand where they stood then, and
  // aren't sent. Empty: nothing moved. Not given: all. Where the service can't build on that step it is sent all.
  // Not with positions in the plan's order, nor with new weights.
  std::optional<std::span<const std::uint64_t>> moved;
  std::span<const std::int64_t> removed;  // ids, distinct, of particles that the scene has
  const Insertion* inserted = nullptr;
  bool want_parts = false;    // fill StepResult::parts
  bool want_changes = false;  // fill StepResult::changes
  double deadline_seconds = 60;
};

// What a step with removals and insertions makes of the rows: row `to` is now what was row `from` or, where `inserted`,
// the inserted particle number `from`. A solver does the same with its arrays, in any order.
struct RowMove {
  std::uint64_t to;
  std::uint64_t from;
  bool inserted;
};

struct StepResult {
  StepReport report;
  std::vector<std::int32_t> parts;  // by row, as the rows are after the step
  std::vector<PartChange> changes;  // ascending row; all rows at the first step of this Scene; the inserted among them
  // Removed rows are taken by the inserted, in ascending row and the order given. More: they are appended. Fewer: the
  // last rows, ascending, take the free ones, ascending.
  std::vector<RowMove> row_moves;
  std::vector<std::int64_t> inserted_ids;  // in the order given
};

// Which of the solver's particles each rank holds, in which order.
struct PlanView {
  std::uint64_t version = 0;
  std::vector<std::span<const std::uint64_t>> rows;  // by rank: rows of the solver's arrays, in the slots' order
};

struct Array {
  std::string name;
  std::string dtype;  // "<f8", "<f4", "<i8", "<i4", "<u8"
  std::vector<std::uint64_t> shape;
  Buffer<std::byte> bytes;

  // The elements. Asked for as another type they are none: an empty span.
  std::span<const double> f8() const;
  std::span<const std::int64_t> i8() const;
  std::span<const std::int32_t> i4() const;
};

struct Reply {
  std::string json;
  std::vector<Array> arrays;
  const Array* find(const std::string& name) const;  // null if absent
};

class Scene;

class Client {
 public:
  static Result<Client> connect(const ConnectOptions& options);
  Client(Client&&) noexcept;
  Client& operator=(Client&&) noexcept;
  ~Client();  // says goodbye

  Status create_scene(const std::string& name, const SceneOptions& options);
  // Holds the scene open until the Scene goes. It must not outlive the Client.
  Result<Scene> open_scene(const std::string& name);
  Status drop_scene(const std::string& name);
  Status shutdown_service();

  // Any command of PROTOCOL.md but pushes: arguments is a JSON object without "command" ("" or "{}" for none).
  Result<Reply> call(const std::string& command, const std::string& arguments_json = "{}",
                     double deadline_seconds = 60);
  // Calls take(report) for each of the reports, in the order of the steps. They are fetched a page at a time: the
  // longest history takes no more memory than a short one. A failure of `take` ends it and is returned. Errors also:
  // aborted, where the scene was made anew meanwhile.
  Result<HistoryRead> history(const std::string& scene, const HistoryRange& range,
                              const std::function<Status(const StepReport&)>& take, double deadline_seconds = 60);
  int ranks() const;
  const std::string& endpoint() const;  // the one that answered

 private:
  friend class Scene;
  friend class MemberScene;
  struct State;
  explicit Client(std::shared_ptr<State> state);
  std::shared_ptr<State> state_;
};

class Scene {
 public:
  Scene(Scene&&) noexcept;
  Scene& operator=(Scene&&) noexcept;
  ~Scene();

  // Pushes one step; returns when it is committed everywhere, or given up with the previous step standing. A lost
  // service, or connection, is waited for until the deadline; a stale plan is fetched once before a failure is
  // returned.
  Result<StepResult> step(const Positions& positions, const StepOptions& options = {});
  // A step in which nothing moved: one round trip, for a caller without its positions at hand. Removals and insertions
  // are taken. Errors also: base_lost, where the service's last step isn't this Scene's, or it has lost the scene: push
  // all positions.
  Result<StepResult> step_unmoved(const StepOptions& options = {});
  // A step in which these particles moved: positions[k] is that of ids[k], [ids.size()], in rows or axes; for a caller
  // without all positions at hand (else: StepOptions::moved). Errors also: base_lost, as above.
  Result<StepResult> step_moved(std::span<const std::int64_t> ids, const Positions& positions,
                                const StepOptions& options = {});
  std::optional<std::int64_t> last_step() const;
  // The plan of the next push; it stands until that push. Fetched where it isn't known. A solver that pushes in its
  // order asks after every step that migrated, or whose report says scene_recreated (the version tells), and gives the
  // version back with its positions: a plan that has changed in between refuses the push with stale_plan.
  Result<PlanView> plan(double deadline_seconds = 60);

 private:
  friend class Client;
  struct State;
  explicit Scene(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace rcb::client
