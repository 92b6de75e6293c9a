// The C++ client: connect, create a scene, push positions every step.
//
//   auto client = rcb::client::Client::connect({});
//   client->create_scene("jet", {.parts = 8, .replace = true});
//   auto scene = client->open_scene("jet");
//   auto result = scene->step(rcb::client::Positions::rows(xyz.data(), n, 3));
//
// The processes of a parallel solver each take a seat of the scene, and push the particles they have:
//
//   auto scene = client->open_scene("jet", {.seat = rank, .seats = size});
//   auto result = scene->step(rcb::client::Positions::axes(axes, n), {.ids = ids});
//   // then send the rows result->leaving to the processes of those seats, and add what these send
//
// A call that loses its connection, or whose service died and is started again, reconnects until its deadline. Reads
// are repeated automatically. So is a step, which the service applies only once. The scenes of a service outlive it but
// for their particles, which the next step brings. Other commands that were cut off fail with `unavailable`: the caller
// has to ask whether they took effect. Thread-safety: a Client and its Scenes belong to one thread at a time. No call
// waits without a deadline. Errors are returned as Status: code, message, hint.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/base/status.hpp"
#include "common/cuts/cuts.hpp"

namespace rcb::client {

// How positions come to the ranks: from memory that these share with the solver, over sockets straight to each of them
// (direct), or all through the endpoint (gateway). automatic: as the environment's RCBD_PATH says (auto, shared,
// direct, gateway); by default through shared memory with the ranks on this machine, else large pushes directly if
// the ranks' own addresses answer. Where a push can't take `shared`, it takes another; `direct` fails where it can't.
enum class Path { automatic, shared, direct, gateway };
// By the words of RCBD_PATH; none: it is another word.
std::optional<Path> path_from_name(std::string_view name);

// Deadlines, here and below: within them attempts begin, and the service is told to answer. The call itself returns
// later by at most 2 s or 5 %, whichever is more, so that what the service answers at the deadline still arrives.
struct ConnectOptions {
  // unix:PATH, HOST:PORT or file:PATH (what `rcbctl up --publish` writes); empty: RCBD_ENDPOINT, else the default
  // socket, else 127.0.0.1:7470.
  std::string endpoint{};
  double deadline_seconds = 5;  // for connecting and saying hello
  std::string name = "rcb client";
  // TCP only; empty: RCBD_TOKEN, else the file RCBD_TOKEN_FILE, else, for a service on this machine, the token in its
  // data directory.
  std::string token{};
  Path path = Path::automatic;
  // Called with a text that says what a call waits for: a notice from the service, or that the service has gone. Empty:
  // the text goes to standard error, after `name`. It must not throw, nor call the client.
  std::function<void(const std::string&)> on_notice{};
  // Called about ten times a second while a call waits for the service. If it returns false, the call ends with
  // `interrupted`; whether the service does what was asked is then not known. It must not throw, nor call the client.
  std::function<bool()> on_wait{};
  // Once connected: if true, calls wait until their deadline for a service that has gone; so do create_scene() and
  // drop_scene(), and open_scene() for a seat, for another client that holds the scene. If false, one new connection is
  // tried, and a held scene is an error.
  bool outlive = true;
};

struct SceneOptions {
  int parts = 1;
  int dims = 3;
  std::string method = "rcb";        // or "bands-x", "bands-y", "bands-z"
  double tolerance = 0.1;            // >= 0; infinity forbids automatic repartitions
  double axis_hysteresis = 1.2;      // >= 1: a cut keeps its axis until another is longer by this factor
  double cut_tolerance = 0;          // 0 to 1: how far off target new cuts may leave a part, as a fraction; 0: exact
  std::string policy = "tolerance";  // or "cost": repartition when imbalance has cost more than a repartition
  std::vector<double> part_sizes{};  // [parts] > 0, in no unit: the share of each; empty: equal shares
  // When step() has the service's ranks take the positions: "every-step", or "when-needed": at first, where the cuts
  // may have to change, and where a question about positions waits. In other steps this library counts by the cuts
  // itself, which takes one pass over the positions, and sends the counts.
  std::string positions = "every-step";
  int threads = 1;       // for counting
  bool replace = false;  // drops a scene of that name first; else it is an error (already_exists)
};

using Positions = cuts::Positions;  // in the caller's memory, where they stay

struct StepReport {
  std::string scene;
  std::int64_t step = 0;
  std::uint64_t epoch = 0;  // rises whenever new cuts are adopted
  std::uint64_t n = 0;
  int parts = 0;                       // another client's rebalance may change it between two steps
  std::optional<double> error_before;  // none at the first push
  double error = 0;
  double imbalance = 1;  // max(load / target)
  bool repartitioned = false;
  std::string reason;
  int axes_flipped = 0;
  // Particles that moved across a cut into another part since the step before. None where neither the Scene nor the
  // ranks can tell: the rows are of other particles, or in another order, than those of the step before.
  std::optional<std::uint64_t> drifted;
  std::uint64_t moved = 0;     // particles whose part new cuts changed
  std::uint64_t migrated = 0;  // of these, those that changed rank
  std::uint64_t inserted = 0;
  std::uint64_t removed = 0;
  std::uint64_t weights_as_zero = 0;           // particles whose weight is too far below the greatest one to count
  bool sent = true;                            // the ranks took positions in this step
  std::optional<std::int64_t> positions_step;  // whose positions the ranks hold
  std::uint64_t strangers = 0;                 // particles that were outside their seat's parts; 0 for one seat
  std::uint64_t scanned = 0;                   // particles whose positions were sent
  std::uint64_t searched = 0;                  // particles that the search for cuts looked at
  std::uint64_t rounds = 0;                    // of the search for cuts; 0: there was no search
  std::uint64_t reductions = 0;                // collectives of the search
  std::vector<std::string> skipped;
  std::uint64_t bytes = 0;
  std::string way;  // how the positions came: "endpoint", "sockets", "shared-memory", "file" (load); or "count"
  double seconds_receive = 0, seconds_exchange = 0, seconds_search = 0, seconds_migrate = 0, seconds_total = 0;
  std::string json;  // the report as the service sent it
};

// Selects step reports of a scene. Neither given: all. `first` alone: that many of the oldest. `last` alone: that many
// of the newest. Both: the oldest `first` among the newest `last`.
struct HistoryRange {
  std::optional<std::uint64_t> first{};
  std::optional<std::uint64_t> last{};
};

struct HistoryRead {
  std::uint64_t from = 0;  // number of the first report, counted from the scene's first step
  std::uint64_t reports = 0;
  std::uint64_t lost = 0;  // reports in that range that the service's disk could not store or return
  std::string loss;        // why they are lost
};

struct PartChange {
  std::uint64_t row;  // index into the caller's arrays
  std::int32_t part;
};

struct LeavingRow {
  std::uint64_t row;  // index into the caller's arrays
  int to;             // seat
};

// Seat k of M keeps the particles of the parts [floor(k P / M), floor((k+1) P / M)). Seats need not communicate: the
// service alone decides. A step returns when every seat has made it and it is committed; at its deadline it fails with
// the name of a seat that is missing, the previous step stands, and all may make it again.
struct SeatOptions {
  int seat = 0;   // 0 .. seats-1
  int seats = 1;  // the same for all; 1: this client has all particles
  double deadline_seconds = 60;
};

struct StepOptions {
  std::optional<std::int64_t> step{};  // default: the last step + 1; 0 for the first
  // [count], distinct, >= 0, in any order: whose positions the rows are. Empty: row k is the particle k, which one seat
  // alone can say, and only while the scene's ids are 0..n-1.
  std::span<const std::int64_t> ids{};
  // [count]; empty: the scene has none, or those given last for these rows. Whether a scene has weights is decided by
  // its first step.
  std::span<const double> weights{};
  // How many particles have come since the last step, and how many of the last step are gone; then ids are required.
  // With several seats each says it of its own rows: particles that only go from one seat to another are neither. A
  // step with other particles than it says is refused (not_conserved).
  std::uint64_t inserted = 0, removed = 0;
  // Computing time of the solver since its last step, here; the policy "cost" decides by that of the slowest seat.
  std::optional<double> step_seconds{};
  // Pushes the positions even where a count would do, so that questions about them are answered as of this step: for
  // the last one of a run. Several seats all say it; where only some do, the others count first and are told to push.
  bool send = false;
  bool want_parts = false;    // fill StepResult::parts
  bool want_changes = false;  // fill StepResult::changes
  int threads = 1;            // for counting, and for finding parts
  double deadline_seconds = 60;
};

struct StepResult {
  StepReport report;
  // By row, under the cuts after the step: those of Scene::cuts(). If the connection was lost on the way and another
  // client has repartitioned before the cuts could be asked for, they are of a later epoch.
  std::vector<std::int32_t> parts;
  // By ascending row: the rows whose part differs from what this Scene told last (by `parts` or `changes`); all rows if
  // there are more or fewer than then, or their ids differ.
  std::vector<PartChange> changes;
  // Of several seats: the rows in other seats' parts, ascending. What wasn't handed over is named again.
  std::vector<LeavingRow> leaving;
};

struct Array {
  std::string name;
  std::string dtype;  // "<f8", "<f4", "<i8", "<i4", "<u8"
  std::vector<std::uint64_t> shape;
  Buffer<std::byte> bytes;

  // The elements; an empty span if the array has another type.
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

  Status create_scene(const std::string& name, const SceneOptions& options, double deadline_seconds = 60);
  // The scene stays open as long as the Scene lives, which must not outlive the Client. A scene that is dropped, or
  // made anew, is another one (not_found): open that. One Scene for each scene: a step number that another one of this
  // client has pushed is refused (stale_step). With seats > 1 takes the seat of a scene that one of the processes, or
  // another client, has created; a process that is started again takes it anew, and goes on from the last step. Errors:
  // not_found, busy (another client has the seat and keeps it until the deadline, or this client has the scene open
  // otherwise), invalid_argument (another number of seats than the others say).
  Result<Scene> open_scene(const std::string& name, const SeatOptions& options = {});
  Status drop_scene(const std::string& name, double deadline_seconds = 60);
  Status shutdown_service();

  // Any command of PROTOCOL.md except pushes. arguments_json: a JSON object without "command" ("" or "{}" for none).
  Result<Reply> call(const std::string& command, const std::string& arguments_json = "{}",
                     double deadline_seconds = 60);
  // Calls take(report) for each report, in the order of the steps. Reports are fetched a page at a time, so that a long
  // history takes no more memory than a short one. An error of `take` ends the call and is returned. Errors also:
  // aborted, if the scene was created again meanwhile.
  Result<HistoryRead> history(const std::string& scene, const HistoryRange& range,
                              const std::function<Status(const StepReport&)>& take, double deadline_seconds = 60);
  int ranks() const;
  const std::string& endpoint() const;  // the one that answered

 private:
  friend class Scene;
  struct State;
  explicit Client(std::shared_ptr<State> state);
  std::shared_ptr<State> state_;
};

class Scene {
 public:
  Scene(Scene&&) noexcept;
  Scene& operator=(Scene&&) noexcept;
  ~Scene();

  // Makes one step with all rows that this seat has; their count may be 0. Returns when it is committed on all ranks.
  // After an error the previous step stands; only after deadline_exceeded and unavailable, and aborted with several
  // seats, it may be committed all the same. The next call settles it:
  // - the same content again: it returns the answer to that step;
  // - other content: it becomes the step after that one. But if that step was the first, or particles came or went with
  //   it, the error is stale_step: push its content again first.
  // Waits until the deadline for a lost service or connection. Errors also: not_conserved, duplicate_id.
  Result<StepResult> step(const Positions& positions, const StepOptions& options = {});
  // Arrays for `count` positions, for a solver that computes in them: [count][dims] in C order, or an array [count] for
  // each axis. Where the service is on this host its ranks read them there, so that a step with them copies nothing. A
  // later call gives the same arrays, with what is in them, unless it asks for another kind, or for more than there is
  // room for; then the older ones are gone. They live as long as the Scene. Errors: too_large.
  Result<std::span<double>> position_rows(std::size_t count);
  Result<std::vector<std::span<double>>> position_axes(std::size_t count);
  Result<std::span<float>> position_rows_f4(std::size_t count);
  Result<std::vector<std::span<float>>> position_axes_f4(std::size_t count);
  // What keeps these arrays where they are for as long as it is held, also when there are others, or the Scene has
  // gone.
  std::shared_ptr<const void> position_memory() const;
  std::optional<std::int64_t> last_step() const;
  // The cuts after the last step that was answered here, which came with that answer, or before any the cuts in force.
  // Errors: also not_found (no positions yet).
  Result<rcb::cuts::Cuts> cuts(double deadline_seconds = 60);

 private:
  friend class Client;
  struct State;
  explicit Scene(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace rcb::client
