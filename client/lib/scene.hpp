// What the client knows of a scene that it pushes to.
//
// Invariants
// 1. plan_ and parts_ tell of the same moment; after a commit they are brought up to date from the changes in the
//    answer, and where the answer's version or checksum contradicts the result they are fetched instead.
// 2. A push that failed changes nothing here.
// 3. While lost_, the service has the scene without particles and this client knows which there were: the next push
//    brings them all. What a push needs for that and a caller need not give again, ids and weights, is kept.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "client/lib/lost_scene.hpp"
#include "client/lib/push_source.hpp"
#include "client/lib/session.hpp"
#include "common/plan/plan.hpp"

namespace rcb::client {

// One step as its caller asks for it.
struct Ask {
  enum class Moved { all, rows, ids, none };

  Positions positions;
  StepOptions options;
  Moved moved = Moved::all;           // rows: options.moved of all positions; ids: positions are those of `ids` alone
  std::span<const std::int64_t> ids;  // that moved

  bool edits() const { return !options.removed.empty() || options.inserted != nullptr; }
  std::size_t inserted() const { return options.inserted == nullptr ? 0 : options.inserted->positions.count; }
  bool whole() const { return moved == Moved::all || moved == Moved::rows; }  // all positions are at hand
};

// Few particles of a plan, by rank, in ascending slot.
struct Selection {
  std::vector<std::vector<std::uint64_t>> slots;
  std::vector<std::vector<std::uint64_t>> places;  // in the caller's arrays
};

// What the removals and insertions of a step are to the rows.
struct RowEdit {
  std::vector<std::uint64_t> removed;  // ascending
  plan::RankEdit moves;
  std::vector<std::int32_t> inserted_part;  // when they arrived, as far as the answer tells
};

struct Scene::State {
 public:
  State(std::shared_ptr<Client::State> client, std::string name);
  ~State();

  Status open(double deadline_seconds);
  Result<StepResult> step(Ask ask);
  int dims() const { return dims_; }
  std::optional<std::int64_t> last_step() const { return last_step_; }
  Result<PlanView> plan(double deadline_seconds);

 private:
  // What the service says of the scene.
  struct Description {
    int dims;
    int parts;
    std::uint64_t count;
    std::uint64_t epoch;
    std::optional<std::int64_t> step;  // none: it has no positions
    bool ids, weights;
  };

  Session& session() const { return *client_->session; }
  static Result<Description> read_description(const wire::Json& json);
  Status wrong(std::string message, std::string hint) const;
  Status check(const Ask& ask) const;
  Status check_positions(const Ask& ask) const;
  Status check_edits(const Ask& ask) const;
  // version: of the plan, for the caller.
  Status check_plan_order(const Positions& positions, const plan::Plan& plan, std::uint64_t version) const;
  bool has_particles() const { return pushed_ || lost_; }
  // Has the scene open on the connection that stands. Finds out whether it is still the one that was pushed to.
  Status hold(const Retry& retry);
  void lose();
  void forget_plan();
  // All particles with their ids and weights, from what the caller gives and what is kept here; `rows` holds those that
  // came in the order of a plan. Errors: base_lost, which says what is missing.
  Result<Ask> whole_again(const Ask& ask, Buffer<std::byte>& rows) const;
  bool in_lost_order(const Ask& ask) const;
  Ask by_rows(const Ask& ask, Buffer<std::byte>& rows) const;
  Status base_lost(const std::string& why) const;
  // A caller that gives other particles than were lost begins anew.
  void forget_lost_if_others(const Ask& ask);
  // Makes the lost particles present again, as they stand now, under the number of the last step: for a step that
  // inserts or removes some of them.
  Status restore(const Ask& whole, const Retry& retry);
  // One try of a step.
  Result<StepResult> try_step(const Ask& ask, std::int64_t step, std::optional<std::int64_t> base, const Retry& retry);
  // The plan, where it is missing.
  Status ready(std::uint64_t count, std::span<const std::int64_t> ids, const Retry& retry, bool with_plan = true);
  // On success plan_, parts_ and ids_ are new; on failure all is as before.
  Status fetch_plan(std::span<const std::int64_t> ids, const Retry& retry);
  Result<Frame> push(const Ask& ask, std::int64_t step, std::optional<std::int64_t> base, const Retry& retry);
  Result<Frame> send(wire::Json begin, const RankRows& rows, std::vector<Column> columns, const Ask& ask,
                     const std::string& what, const Deadline& deadline);
  Result<StepResult> finish(const Frame& answer, std::int64_t step, const Ask& ask, const Retry& retry);
  // The first positions of the scene, or those that make up for lost ones, are with the service.
  void take_first(const Ask& ask);
  void keep_weights(std::span<const double> weights);
  // Where the moved particles stand in the plan. Errors: invalid_argument, not_found.
  Result<Selection> select(const Ask& ask) const;
  // Errors: not_found, invalid_argument (ids that the scene hasn't, or twice).
  Result<RowEdit> row_edit(const Ask& ask) const;
  // Rows, ids and parts after the edit; the plan where the answer tells enough, else it is dropped.
  void edit_rows(const Ask& ask, RowEdit& edit, const StepReport& report, const Frame& answer, bool follows,
                 StepResult& result);
  // The parts of the inserted stay open (-1).
  void move_rows(const RowEdit& edit, std::span<const std::int64_t> ids);
  Status apply(const Frame& answer, const wire::Json& json, bool first, std::vector<PartChange>& changes);
  std::vector<PartChange> all_parts() const;
  std::vector<PartChange> changes_since_known() const;
  // Versions as the caller sees them: no two plans of this Scene share one, though a new service counts from 0 again.
  std::uint64_t version_for_caller() const { return versions_before_ + plan_->version(); }
  // The scene's ids by row, as far as this client can know them.
  std::span<const std::int64_t> ids_by_row(std::span<const std::int64_t> given) const;

  std::shared_ptr<Client::State> client_;
  std::string name_;
  KnownScene scene_;
  std::uint64_t generation_ = 0;  // of the connection that holds it open
  int dims_ = 3;
  int parts_count_ = 1;
  bool pushed_ = false;   // it has positions
  bool lost_ = false;     // it had some
  bool has_ids_ = false;  // of its own
  bool has_weights_ = false;
  std::uint64_t count_ = 0;
  std::uint64_t epoch_ = 0;
  std::optional<std::int64_t> last_step_;
  std::optional<plan::Plan> plan_;
  std::vector<std::int64_t> ids_;         // by row, once they are the scene's; empty: id = row
  std::vector<std::int32_t> parts_;       // by row
  std::vector<std::int32_t> known_;       // what the caller was told, where parts_ was fetched since; else empty
  std::uint64_t count_if_committed_ = 0;  // by the push that is under way
  bool told_ = false;                     // a step was answered: changes are counted from there
  std::vector<double> weights_;           // by row, where a loss of the service is to be outlived
  std::optional<plan::Plan> lost_plan_;   // the last one before the loss
  std::uint64_t lost_version_ = 0;        // of it, for the caller
  std::uint64_t versions_before_ = 0;
  std::uint64_t version_given_ = 0;  // the last one that the caller was told
  bool restored_ = false;            // by restore(), in the step under way
};

}  // namespace rcb::client
