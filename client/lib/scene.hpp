// What the client knows of a scene that it pushes to.
//
// Invariants
// 1. plan_ and parts_ tell of the same moment; after a commit they are brought up to date from the changes in the
//    answer, and where the answer's version or checksum contradicts the result they are fetched instead.
// 2. A push that failed changes nothing here but the attempt number.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "client/lib/session.hpp"
#include "common/plan/plan.hpp"

namespace rcb::client {

struct Scene::State {
 public:
  State(std::shared_ptr<Client::State> client, std::string name) : client_(std::move(client)), name_(std::move(name)) {}
  ~State();

  Status open(double deadline_seconds);
  Result<StepResult> step(const Positions& positions, const StepOptions& options);
  std::optional<std::int64_t> last_step() const { return last_step_; }
  Result<PlanView> plan(double deadline_seconds);

 private:
  Session& session() const { return *client_->session; }
  Status take_description(const wire::Json& json);
  Status check(const Positions& positions, const StepOptions& options) const;
  Status check_plan_order(const Positions& positions) const;
  // Connection, open scene and plan, whichever is missing.
  Status ready(std::uint64_t count, std::span<const std::int64_t> ids, const Deadline& deadline);
  Status open_again(const Deadline& deadline);
  // On success plan_, parts_ and ids_ are new; on failure all is as before.
  Status fetch_plan(std::span<const std::int64_t> ids, const Deadline& deadline);
  Result<Frame> push(const Positions& positions, const StepOptions& options, std::int64_t step,
                     const Deadline& deadline);
  Result<StepResult> finish(const Frame& answer, std::int64_t step, const Positions& positions,
                            const StepOptions& options, const Deadline& deadline);
  Status apply(const Frame& answer, const wire::Json& json, bool first, std::vector<PartChange>& changes);
  std::vector<PartChange> all_parts() const;
  std::vector<PartChange> changes_since_known() const;
  // The scene's ids by row, as far as this client can know them.
  std::span<const std::int64_t> ids_by_row(std::span<const std::int64_t> given) const;

  std::shared_ptr<Client::State> client_;
  std::string name_;
  std::uint64_t generation_ = 0;  // of the connection that holds it open
  int dims_ = 3;
  int parts_count_ = 1;
  bool pushed_ = false;   // it has positions
  bool has_ids_ = false;  // of its own
  bool has_weights_ = false;
  std::uint64_t count_ = 0;
  std::uint64_t epoch_ = 0;
  std::optional<std::int64_t> last_step_;
  std::int64_t attempt_ = 0;
  std::optional<plan::Plan> plan_;
  std::vector<std::int64_t> ids_;    // by row, once they are the scene's; empty: id = row
  std::vector<std::int32_t> parts_;  // by row
  std::vector<std::int32_t> known_;  // what the caller was told, where parts_ was fetched since; else empty
  bool told_ = false;                // a step was answered: changes are counted from there
};

}  // namespace rcb::client
