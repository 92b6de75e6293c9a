// Ledger: rank 0's scene. It knows everything of a scene but its particles, takes in what orders have done to it, and
// answers steps that are counts, for which no other rank is woken. A pure state machine: a decision is a value, and
// only a commit changes anything.
//
// Invariants
// 1. `now().loads` are those of the last step, whether its positions travelled or not; Held of an order says what the
//    ranks hold, which are the positions of `positions_step`.
// 2. A step is in the history exactly once; so are its costs in the account.
// 3. count() changes nothing unless it commits. What it tells to send is decided anew, by the same rule from the same
//    numbers, when the positions have come.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <variant>

#include "server/scene/count.hpp"
#include "server/scene/events.hpp"
#include "server/scene/history.hpp"
#include "server/scene/policy.hpp"

namespace rcb::scene {

struct SceneTotals : StepCounts {
  std::uint64_t steps = 0;
  std::uint64_t repartitions = 0;  // including the first partition
  std::map<std::string, std::uint64_t> skipped;
  std::map<std::string, std::uint64_t> asked;  // by command: queries whose answer took a pass over the particles
};

// Everything that must last, but the cuts' bytes and the history.
struct SceneState : Held {
  SceneOptions options;
  std::uint64_t incarnation = 0;               // from its making: no other's, and above those of earlier scenes
  std::optional<std::int64_t> step;            // the last one; none: no positions yet
  std::optional<std::int64_t> positions_step;  // whose positions the ranks hold; none: nobody can say
  bool filled = false;                         // the ranks hold its particles, of whatever step
  bool others = false;                         // particles came or went since positions_step, by counts
};

// A ledger without its history.
struct Lasting {
  SceneState now;
  SceneTotals totals;
  CostAccount costs;
  std::optional<double> error_when_not_adopted;  // error_before of the last wasted search
  std::vector<std::uint64_t> last_sessions;      // session_key() of each seat that brought the last step
  std::string last_report;                       // as JSON; empty: no step yet
};

// What a count leads to.
struct CountVerdict {
  // Its positions are to be pushed, under the same step number.
  struct Send {
    std::string why;
  };
  struct OtherCuts {};  // than those it was counted by are in force
  struct OtherScale {
    int exponent = 0;
  };
  struct Committed {
    StepReport report;
    std::optional<std::int64_t> previous_step;
  };
  std::variant<Status, Send, OtherCuts, OtherScale, Committed> is;
};

class Ledger {
 public:
  // With more parts a count would keep other clients waiting: a part takes 20 ns, with weights up to a microsecond.
  static constexpr int kPartsMax = 65536;
  static constexpr int kWeightedPartsMax = 4096;

  // The memory must outlive it. journal: null where nothing lasts, and then `loss` says why.
  Ledger(std::string name, Created created, std::uint64_t incarnation, HistoryMemory& memory,
         std::unique_ptr<Journal> journal, std::string loss = {});
  // Of an earlier service.
  Ledger(std::string name, Lasting lasting, HistoryMemory& memory, std::unique_ptr<Journal> journal);

  const std::string& name() const { return name_; }
  const SceneState& now() const { return now_; }
  const SceneTotals& totals() const { return totals_; }
  const History& history() const { return *history_; }
  const Journal* journal() const { return journal_.get(); }

  // What the decision about the next push needs; step_seconds: as that push says.
  DecisionTerms terms(std::optional<double> step_seconds) const;
  const StepReport& take(Stepped stepped);  // returns the report as it is in the history
  void take(Rebalanced rebalanced);
  void take(const Asked& asked);

  // Why whatever is counted is told to send; none: it isn't. So the counts of the seats needn't be added up.
  std::optional<CountVerdict::Send> always_sends() const;
  CountVerdict count(const CountRecord& record);
  // What a count must fit even if it is only that of one of the scene's seats. Errors: stale_step, not_found (another
  // incarnation).
  Status check_seat(const CountRecord& record) const;
  // Whether the last step is this one, and this session has brought it, or a seat's share of it.
  bool was_in_last(const std::string& session, std::int64_t step) const;
  const std::string& last_report() const { return lasting_.last_report; }

  // No later service knows the scene from here on. Returns what removes its files, for any thread.
  std::function<void()> drop();

  // A question waits for the positions of the next step. Withdrawn by that step.
  void want_positions() { wants_positions_ = true; }
  bool wants_positions() const { return wants_positions_; }

 private:
  Status check(const CountRecord& record) const;
  CountVerdict commit(const CountRecord& record, partition::LoadSummary loads, const Decision& decision);
  void remember(const StepReport& report, std::vector<std::uint64_t> sessions);
  // Puts cuts and state into the journal.
  void keep();

  std::string name_;
  Lasting lasting_;
  SceneState& now_ = lasting_.now;
  SceneTotals& totals_ = lasting_.totals;
  std::unique_ptr<Journal> journal_;
  std::unique_ptr<History> history_;
  std::uint64_t kept_hash_ = 0;  // of the cuts in the journal
  bool keeps_ = true;            // the journal has taken the last state
  std::string frame_;            // encode_frame(now_); empty: it has changed
  bool asked_ = false;           // a query as in SceneTotals::asked came since the last step
  bool wants_positions_ = false;
};

// Refusal of a step of a scene that was replaced.
Status made_anew(const std::string& scene);
// Refusal of a step that is not above the scene's last one.
Status stale_step(const std::string& scene, std::int64_t step, std::int64_t last);

// What of the scenes lasts, and where.
struct Keeping {
  std::size_t keep_reports = 100'000;          // step reports in memory, all scenes together
  std::shared_ptr<Storage> storage = nullptr;  // null: nothing lasts
  std::string data_dir = {};
};

// What a start has found of an earlier service.
struct Restored {
  std::uint64_t scenes = 0;
  std::uint64_t steps = 0;
  std::uint64_t lost_records = 0;
};

// All scenes, by name.
class Ledgers {
 public:
  explicit Ledgers(Keeping keeping)
      : keeping_(std::move(keeping)),
        memory_(std::make_unique<HistoryMemory>(keeping_.keep_reports, keeping_.storage)) {}

  // The scenes that an earlier service has left. What can't be read is logged, and left where it is.
  Restored restore();
  // What is kept of the scene stays.
  void forget(const std::string& scene) { ledgers_.erase(scene); }
  // Takes in what an order has done. incarnation: of a scene that it has made. Returns the report of a step.
  const StepReport* take(Change change, std::uint64_t incarnation);
  Ledger* find(const std::string& scene);
  const Ledger* find(const std::string& scene) const;
  bool contains(const std::string& scene) const { return ledgers_.contains(scene); }
  bool empty() const { return ledgers_.empty(); }
  auto begin() const { return ledgers_.begin(); }
  auto end() const { return ledgers_.end(); }

 private:
  Status restore_one(const SceneFolder& folder);
  void drop(const std::string& scene);

  Keeping keeping_;
  std::unique_ptr<HistoryMemory> memory_;  // outlives the ledgers
  std::map<std::string, Ledger> ledgers_;
};

}  // namespace rcb::scene
