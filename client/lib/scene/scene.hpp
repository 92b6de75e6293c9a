// Room `scene`: a client's scene, or its seat of one: its steps, and its history. The public classes are in
// client/lib/client.hpp.
//
// Scene::State: what the client knows of a scene that it pushes to. scene.cpp opens it, step.cpp makes steps of it,
// push.cpp brings their rows to the ranks.
//
// Invariant: a push that failed changes nothing here but what the service says of the scene.
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

namespace rcb::client {

// Tells rows of the same particles in the same order from others.
struct RowsId {
  std::size_t count = 0;
  cuts::IdSums ids;
  bool operator==(const RowsId&) const = default;
};

// One step as its caller requests it.
struct StepRequest {
  const Positions& positions;
  const StepOptions& options;
  RowsId rows;

  bool flows() const { return options.inserted > 0 || options.removed > 0; }
  bool wants() const { return options.want_parts || options.want_changes; }
  // Smaller pushes go to the endpoint in one write, which spares the coordination with the ranks.
  bool large() const {
    return positions.count * static_cast<std::size_t>(positions.dims) * sizeof(double) >= std::size_t{1} << 18U;
  }
};

struct Scene::State {
 public:
  State(std::shared_ptr<Client::State> client, std::string name, const SeatOptions& seat);
  ~State();

  // Tries until the deadline.
  Status open(Retry& retry);
  Result<StepResult> step(const Positions& positions, const StepOptions& options);
  int dims() const { return dims_; }
  std::optional<std::int64_t> last_step() const { return last_step_; }
  Result<cuts::Cuts> current_cuts(double deadline_seconds);
  SharedArrays& arrays() { return arrays_; }

 private:
  // The service's description of the scene.
  struct Description {
    int dims = 0;
    std::uint64_t epoch = 0;
    std::optional<std::int64_t> step;  // none: the scene has no positions
    bool filled = true;                // the ranks hold its particles
    bool ids = false, weights = false;
    bool when_needed = false;
    std::string incarnation;
    std::uint64_t generation = 0;  // of the seat
  };
  // How rows come to the ranks. held: from shared memory, each rank those of the particles that it holds.
  enum class Way { endpoint, sockets, shared, held };

  // What a push brings beside positions.
  struct Values {
    std::span<const double> weights;
    std::span<const std::int64_t> ids;
  };

  Session& session() const { return *client_->session; }
  bool seated() const { return seat_.seats > 1; }
  std::multiset<std::string>& open_scenes() const { return seated() ? client_->seats : client_->scenes; }
  Result<Description> read_description(const wire::Json& json) const;
  // Opens the scene on the current connection, if it isn't open there, and checks that it is still the one pushed to.
  Status hold(const Retry& retry);
  void close(const Retry& retry) const;
  // The number of the scene's last step, as the service says; none: it has had no step.
  Result<std::optional<std::int64_t>> step_in_force(const Retry& retry) const;

  // What can't be right whatever the service says.
  Status check(const StepRequest& ask) const;
  Status wrong(const std::string& message, std::string hint) const;
  // Makes the step, again and again until the deadline.
  Result<StepResult> step_until_deadline(const StepRequest& ask, std::int64_t step, Retry& retry);
  // One attempt.
  Result<StepResult> try_step(const StepRequest& ask, std::int64_t step, const Retry& retry);
  // A checksum of what the step pushes.
  static std::uint64_t content_of(const StepRequest& ask);
  // Asks whether the unanswered step of an earlier call was committed; true if so, and the caller needs its answer.
  Result<bool> needs_unanswered(const Retry& retry);
  // Whether the step can be a count.
  bool can_count(const StepRequest& ask) const;
  // The answer to the step as a count; nothing if its positions are to be pushed.
  Result<std::optional<Answer>> step_by_count(const StepRequest& ask, std::int64_t step, const Retry& retry);
  // The weights given or, where the rows are the same, kept.
  std::span<const double> weights_of(const StepRequest& ask) const;
  CountedRows rows_of(const StepRequest& ask) const;
  // Of an answer. tried_before: an earlier attempt may have been committed, so that it may repeat the report of that.
  Result<StepReport> report_of(const Result<wire::Json>& json, std::int64_t step, bool tried_before) const;
  Result<StepResult> take_answer(const Answer& answer, const StepRequest& ask, std::int64_t step, bool tried_before,
                                 const Retry& retry);
  // The cuts after a step, if they are told or needed; counted_ then has the parts by them, if these are.
  Result<std::optional<cuts::Cuts>> complete(const Frame& frame, const wire::Json& json, const StepReport& report,
                                             const StepRequest& ask, const Retry& retry);
  // Fills in what depends on the parts.
  void tell_parts(const StepRequest& ask, StepResult& result);

  // What every push says.
  wire::Json push_json(std::int64_t step, const Retry& retry) const;
  Result<Way> choose_way(const StepRequest& ask, const Retry& retry) const;
  // Whether the rows can come from shared memory, and are to.
  bool by_shared_memory(const StepRequest& ask, const Retry& retry) const;
  // The rows that each rank is to take, in row order or, if grouped, by the ranks that own them. list: [count], of
  // rows, rank after rank.
  RankRows rows_by_rank(const StepRequest& ask, bool grouped, std::span<std::uint64_t> list) const;
  std::span<const std::int64_t> row_numbers(std::size_t count);
  Result<Frame> push(const StepRequest& ask, std::int64_t step, const Retry& retry);
  // rows: by rank, where the push says which rows each is to take.
  Result<Frame> send(wire::Json push, const StepRequest& ask, RankRows rows, const Values& values, const Retry& retry);

  std::shared_ptr<Client::State> client_;
  std::string name_;
  SeatOptions seat_;
  int threads_ = 1;                    // SceneOptions::threads
  std::uint64_t generation_ = 0;       // of the connection on which the scene is open
  std::uint64_t seat_generation_ = 0;  // 0: never had the seat
  std::uint64_t seat_asked_ = 0;       // the last generation of the seat that was asked for
  int dims_ = 3;
  std::string incarnation_;
  bool when_needed_ = false;  // the ranks hold positions of the steps that need them alone
  bool filled_ = true;        // the ranks hold the scene's particles, if it has any
  bool has_ids_ = false;      // other than 0..n-1
  bool has_weights_ = false;
  std::uint64_t epoch_ = 0;
  std::optional<std::int64_t> last_step_;  // none: the scene has no positions
  UnansweredStep unanswered_;
  SceneCuts cuts_;
  CountStep counted_;
  RowsId rows_;                  // of the step before
  std::vector<double> weights_;  // as given last, of weights_rows_
  RowsId weights_rows_;
  std::vector<std::int32_t> told_;  // the parts last told to the caller, of told_rows_
  RowsId told_rows_;
  SharedArrays arrays_;
  Buffer<std::uint64_t> list_;    // of rows, rank after rank
  Buffer<std::int64_t> numbers_;  // 0, 1, ...
  Way way_ = Way::endpoint;       // of the current attempt
};

}  // namespace rcb::client
