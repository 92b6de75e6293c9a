// Room `scene`: a single client's scene: its steps and their answers, and its history. The public classes are in
// client/lib/client.hpp.
//
// What the client knows of a scene that it pushes to.
//
// Invariants
// 1. plan_ (the layout) and parts_ are of the same moment. After a commit both are updated from the changes in the
//    answer; if the result doesn't match the answer's version or checksum, they are fetched instead.
// 2. A push that failed changes nothing here.
// 3. While the scene has positions and filled_ is false, the ranks hold none of its particles, since their service was
//    started again: the next push brings all of them. Ids and weights, which the caller need not give again, are kept
//    for this.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "client/lib/scene/client_state.hpp"
#include "client/lib/scene/count_step.hpp"
#include "client/lib/scene/scene_cuts.hpp"
#include "client/lib/session/push_source.hpp"
#include "client/lib/session/session.hpp"
#include "client/lib/session/shared_arrays.hpp"
#include "client/lib/session/unanswered.hpp"
#include "common/layout/layout.hpp"

namespace rcb::client {

// One step as its caller requests it.
struct StepRequest {
  enum class Moved { all, rows, ids, none };

  Positions positions;
  StepOptions options;
  Moved moved = Moved::all;           // rows: options.moved are the rows; ids: positions holds only those of `ids`
  std::span<const std::int64_t> ids;  // of the particles that moved

  bool edits() const { return !options.removed.empty() || options.inserted != nullptr; }
  std::size_t inserted() const { return options.inserted == nullptr ? 0 : options.inserted->positions.count; }
  bool whole() const { return moved == Moved::all || moved == Moved::rows; }  // all positions are at hand
  bool wants() const { return options.want_parts || options.want_changes; }
  // Whether the library finds out the parts by itself, as it has all positions by row.
  bool wants_by_cuts() const { return wants() && whole() && !edits(); }
};

// Some particles of a layout, by rank, in ascending slots.
struct Selection {
  std::vector<std::vector<std::uint64_t>> slots;
  std::vector<std::vector<std::uint64_t>> places;  // indices into the caller's arrays
};

// How the removals and insertions of a step change the rows.
struct RowEdit {
  std::vector<std::uint64_t> removed;  // ascending
  layout::SlotEdit moves;
  std::vector<std::int32_t> inserted_part;  // their parts on arrival, if the answer tells them
};

struct Scene::State {
 public:
  State(std::shared_ptr<Client::State> client, std::string name);
  ~State();

  // Tries until the deadline.
  Status open(Retry& retry);
  Result<StepResult> step(StepRequest ask);
  int dims() {
    forget_if_replaced();
    return dims_;
  }
  std::optional<std::int64_t> last_step() {
    forget_if_replaced();
    return last_step_;
  }
  Result<cuts::Cuts> current_cuts(double deadline_seconds);
  SharedArrays& arrays() { return arrays_; }

 private:
  // The service's description of the scene.
  struct Description {
    int dims = 0;
    int parts = 0;
    std::uint64_t count = 0;
    std::uint64_t epoch = 0;
    std::optional<std::int64_t> step;  // none: the scene has no positions
    bool filled = true;                // the ranks hold its particles
    bool older = false;                // at positions that aren't known to be those of the last step
    bool ids = false, weights = false;
    bool when_needed = false;
    std::string incarnation;
  };

  Session& session() const { return *client_->session; }
  static Result<Description> read_description(const wire::Json& json);
  Status wrong(const std::string& message, std::string hint) const;
  Status check(const StepRequest& ask) const;
  Status check_positions(const StepRequest& ask) const;
  Status check_edits(const StepRequest& ask) const;
  // Forgets the scene if this client has created another one in its place, or dropped it.
  void forget_if_replaced();
  bool held() const { return !replaced_ && generation_ == session().generation(); }
  // Opens the scene on the current connection, if it isn't open there, and checks that it is still the one pushed to.
  Status hold(const Retry& retry);
  bool on_ranks() const { return pushed_ && filled_; }
  // All particles with ids and weights, from what the caller gives and what is kept here. Errors: base_lost, which says
  // what is missing.
  Result<StepRequest> with_all_particles(const StepRequest& ask) const;
  Status base_lost(const std::string& why) const;
  // Brings ranks that hold none all particles, at the positions that this step begins with. Errors: stale_plan, if
  // another client has done so.
  Status refill(const StepRequest& ask, const Retry& retry);
  // Of a step that the service has committed, as it says. It is answered by the report alone.
  Result<Frame> ask_for_answer(const StepRequest& ask, std::int64_t step, const Retry& retry);
  // A committed step. The parts may not be known yet.
  struct Committed {
    StepResult result;
    RowEdit edit;
    bool plan_needed = false;  // layout and parts must be fetched, since the answer doesn't lead to them
  };
  // Pushes a step, again and again until the deadline, and finds out its parts if they are asked.
  Result<StepResult> push_and_complete(StepRequest& ask, std::int64_t step, std::optional<std::int64_t> base,
                                       Retry& retry);
  // One attempt to push a step.
  Result<Committed> try_step(const StepRequest& ask, std::int64_t step, std::optional<std::int64_t> base,
                             const Retry& retry);
  // Whether the step can be a count: where its scene wants that, and all rows are at hand.
  bool can_count(const StepRequest& ask) const;
  CountedRows rows_of(const StepRequest& ask) const;
  // One attempt at the step as a count, if it can be one. Returns the answer with its report; nothing if the step's
  // positions are to be pushed.
  Result<std::optional<Frame>> step_by_count(const StepRequest& ask, std::int64_t step, const Retry& retry);
  // One attempt at the push of a step. Changes what is pushed where the ranks need more than what the step brings.
  Result<Frame> step_by_push(StepRequest& ask, std::int64_t step, std::optional<std::int64_t> base, const Retry& retry);
  // A checksum of what the step pushes.
  std::uint64_t content_of(const StepRequest& ask) const;
  // Asks whether the unanswered step of an earlier call was committed; true if so, and the caller needs its answer.
  Result<bool> needs_unanswered(const Retry& retry);
  // The number of the scene's last step, as the service says; none: it has had no step.
  Result<std::optional<std::int64_t>> step_in_force(const Retry& retry);
  // Makes sure that the layout is there; fetches it if it is missing.
  Status ready(std::uint64_t count, std::span<const std::int64_t> ids, const Retry& retry, bool with_plan);
  void forget_rows();  // which particle is in which row, and their parts
  // On success plan_, parts_ and ids_ are new; on failure all are unchanged.
  Status fetch_plan(std::span<const std::int64_t> ids, const Retry& retry);
  Result<Frame> ask_plan(const Retry& retry) const;
  Status take_plan(const Frame& answer, std::span<const std::int64_t> ids);
  Result<Frame> push(const StepRequest& ask, std::int64_t step, std::optional<std::int64_t> base, const Retry& retry);
  // Whether the step can be pushed from shared memory, and is to be.
  bool by_shared_memory(const StepRequest& ask, const Retry& retry);
  // Whether row k is the particle with the id k, as the ranks take it at a first push, and later if nothing is said.
  bool rows_are_ids(const StepRequest& ask) const;
  Result<Frame> push_shared(wire::Json begin, const StepRequest& ask, const std::string& what,
                            const Deadline& deadline);
  Result<Frame> send(wire::Json begin, const RankRows& rows, std::vector<Column> columns, const StepRequest& ask,
                     const std::string& what, const Deadline& deadline);
  // What the answer to a push says.
  struct Answer {
    wire::Json json;
    StepReport report;
    bool first;                                      // the scene had no positions
    bool repeated;                                   // it is that of an earlier attempt
    bool epoch_follows;                              // on the epoch that this Scene knows
    bool follows;                                    // layout and parts follow from those known
    bool counted = false;                            // its rows are, by the cuts after it
    std::optional<Frame> plan;                       // the answer to `plan`, if it was asked for, too
    std::optional<cuts::Cuts> cuts;                  // after the step, if this Scene uses them
    std::optional<std::vector<std::int32_t>> parts;  // by these, if they are asked for and known here; before edits
    std::vector<std::int32_t> inserted_part;         // by these, of the inserted
  };
  // tried_before: an earlier attempt to push the step may have been committed, so the answer may repeat its report.
  Result<Answer> read_answer(const Frame& frame, std::int64_t step, bool tried_before) const;
  // Adds to the answer what else has to be asked or computed for it.
  Status complete_answer(const Frame& frame, const StepRequest& ask, const Retry& retry, Answer& answer);
  // The parts of all rows before the edit, and of those inserted.
  Status parts_by_cuts(const Frame& frame, const StepRequest& ask, const Retry& retry, Answer& answer) const;
  bool uses_cuts(const StepRequest& ask) const { return cuts_.wanted || ask.wants_by_cuts(); }
  Result<Committed> finish(const Frame& frame, Answer answer, const StepRequest& ask);
  // Fills in parts and changes, and reconnects for it if need be. Errors: the step is committed, but its parts are not
  // known.
  Result<StepResult> complete(const StepRequest& ask, Committed done, Retry& retry);
  Status fetch_plan_of_step(const StepRequest& ask, Retry& retry);
  // By row, after a step.
  std::span<const std::int64_t> ids_of_rows(const StepRequest& ask) const;
  // The service now has the scene's first positions.
  void take_first(const StepRequest& ask);
  void keep_weights(std::span<const double> weights);
  // Rank and slot of the moved particles. Errors: invalid_argument, not_found.
  Result<Selection> select(const StepRequest& ask) const;
  // Errors: not_found, invalid_argument (ids that the scene doesn't have, or given twice).
  Result<RowEdit> row_edit(const StepRequest& ask) const;
  // Updates rows, ids and parts after the edit; also the layout if the answer tells enough, else the layout is dropped.
  void edit_rows(const StepRequest& ask, RowEdit& edit, const StepReport& report, const Frame& answer, bool follows,
                 StepResult& result);
  // The parts of inserted particles are set to -1 (not known yet).
  void move_rows(const RowEdit& edit, std::span<const std::int64_t> ids);
  Status apply(const Frame& answer, const wire::Json& json, bool first, std::vector<PartChange>& changes);
  // What was told to the caller last.
  std::span<const std::int32_t> parts_told() const {
    return !told_ ? std::span<const std::int32_t>() : known_ ? *known_ : parts_;
  }
  // The scene's ids by row, as far as this client can know them.
  std::span<const std::int64_t> ids_by_row(std::span<const std::int64_t> given) const;

  std::shared_ptr<Client::State> client_;
  SharedArrays arrays_;
  bool shared_ = false;              // the current attempt pushes from arrays_
  bool by_id_ = false;               // if shared_: the ranks find the rows by the particles' ids
  bool shared_unsupported_ = false;  // the service doesn't take this scene's positions so
  std::string name_;
  KnownScene scene_;
  std::uint64_t run_ = 0;         // Client::State::runs, when the scene was opened
  bool replaced_ = false;         // it is another since then, and to be opened again
  std::uint64_t generation_ = 0;  // of the connection on which the scene is open
  int dims_ = 3;
  int parts_count_ = 1;
  bool pushed_ = false;   // the scene has positions
  bool filled_ = true;    // if so: the ranks hold its particles
  bool older_ = false;    // perhaps at older positions than those of the last step
  bool has_ids_ = false;  // ids given by a solver
  bool has_weights_ = false;
  std::uint64_t count_ = 0;
  std::uint64_t epoch_ = 0;
  std::optional<std::int64_t> last_step_;
  UnansweredStep unanswered_;
  std::optional<layout::Layout> plan_;
  std::vector<std::int64_t> ids_;    // by row, once the scene has them; empty: id = row
  bool rows_assumed_ = false;        // ids_ was taken in ascending order: the caller hasn't said whose its rows are
  std::vector<std::int32_t> parts_;  // by row
  // By row, the parts last told to the caller; none: these are parts_.
  std::optional<std::vector<std::int32_t>> known_;
  SceneCuts cuts_;
  bool when_needed_ = false;  // the ranks hold positions of the steps that need them alone
  std::string incarnation_;
  CountStep counted_;
  std::uint64_t count_if_committed_ = 0;  // if the service commits the current push
  bool began_ = false;                    // this Scene made the first push, so its rows are known
  bool answered_ = false;                 // a step was answered, so the rows are known
  bool told_ = false;                     // parts were told: changes are relative to them
  bool missed_ = false;                   // a step was committed whose answer this Scene hasn't seen
  bool base_unknown_ = false;             // if missed_: that step may have changed positions that the caller builds on
  std::vector<double> weights_;           // by row; kept to bring them again, and to count
  bool first_ = false;                    // the current step is this scene's first
};

}  // namespace rcb::client
