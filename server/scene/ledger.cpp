#include "server/scene/ledger.hpp"

#include <algorithm>
#include <utility>

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <xxhash.h>

#include "server/scene/lasting.hpp"

namespace rcb::scene {

std::uint64_t session_key(const std::string& session) { return XXH3_64bits(session.data(), session.size()); }

Status stale_step(const std::string& scene, std::int64_t step, std::int64_t last) {
  return {Code::stale_step, fmt::format("step {} of scene '{}' is not above the last one, {}", step, scene, last),
          fmt::format("another client has pushed, or a solver begins anew: push step {} or a later one, or create the "
                      "scene anew with replace; or each process of a parallel solver has opened the scene by itself: "
                      "then give seat and seats",
                      last + 1)};
}

Status made_anew(const std::string& scene) {
  return {Code::not_found, fmt::format("scene '{}' was made anew since it was opened here", scene),
          "open it again, and push its positions"};
}

Ledger::Ledger(std::string name, Created created, std::uint64_t incarnation, HistoryMemory& memory,
               std::unique_ptr<Journal> journal, std::string loss)
    : name_(std::move(name)),
      journal_(std::move(journal)),
      history_(std::make_unique<History>(memory, name_, 0, std::move(loss))) {
  static_cast<Held&>(now_) = std::move(created.held);
  now_.options = std::move(created.options);
  now_.incarnation = incarnation;
  keep();
}

Ledger::Ledger(std::string name, Lasting lasting, HistoryMemory& memory, std::unique_ptr<Journal> journal)
    : name_(std::move(name)),
      lasting_(std::move(lasting)),
      journal_(std::move(journal)),
      history_(
          std::make_unique<History>(memory, name_, totals_.steps,
                                    journal_->reports() < totals_.steps ? "an earlier service could not keep it" : "")),
      kept_hash_(now_.hash) {}

void Ledger::keep() {
  if (!journal_) return;
  Status kept;
  const bool new_cuts = now_.tree && now_.hash != kept_hash_;
  if (new_cuts) kept = journal_->put_cuts(encode(*now_.tree));
  const bool put = new_cuts && kept.ok();
  if (frame_.empty()) frame_ = encode_frame(now_);
  if (kept.ok()) kept = journal_->put_state(encode(lasting_, frame_));
  if (put && kept.ok())
    kept_hash_ = now_.hash;
  else if (put)
    journal_->hold_older_cuts();  // which the state in the journal names
  if (!kept.ok() && keeps_) spdlog::warn("scene '{}' will not outlive the service: {}", name_, kept.message());
  keeps_ = kept.ok();
}

std::function<void()> Ledger::drop() {
  if (!journal_) return [] {};
  if (const Status told = journal_->put_state(""); !told.ok())
    spdlog::warn("scene '{}' may be there again after a restart: {}", name_, told.message());
  return [journal = std::shared_ptr<Journal>(std::move(journal_)), name = name_] {
    if (const Status removed = journal->remove(); !removed.ok())
      spdlog::warn("what was kept of scene '{}' can't be removed: {}", name, removed.message());
  };
}

DecisionTerms Ledger::terms(std::optional<double> step_seconds) const {
  DecisionTerms terms;
  terms.error_when_not_adopted = lasting_.error_when_not_adopted;
  if (now_.options.policy != Policy::cost || !step_seconds || !now_.step) return terms;
  terms.timed = true;
  terms.lost_seconds = lasting_.costs.lost_seconds_with(*step_seconds, now_.loads->imbalance);
  terms.repartition_seconds = lasting_.costs.repartition_seconds();
  terms.balanced_seconds = *step_seconds / now_.loads->imbalance;
  terms.best_imbalance = lasting_.costs.best_imbalance();
  terms.since = lasting_.costs.since();
  return terms;
}

const StepReport& Ledger::take(Stepped stepped) {
  StepReport& report = stepped.report;
  // The ranks have compared with the positions that they held.
  if (now_.step && now_.positions_step != now_.step) {
    report.drifted_known = stepped.drifted.has_value();
    report.drifted = stepped.drifted.value_or(0);
  }
  if (now_.step && stepped.step_seconds) lasting_.costs.computed(*stepped.step_seconds, now_.loads->imbalance);
  if (report.repartitioned) {
    lasting_.error_when_not_adopted.reset();
    lasting_.costs.start_again(report.imbalance);
    lasting_.costs.repartitioned(report.step, report.seconds.search + report.seconds.migrate, !now_.step);
  } else if (stepped.wasted) {
    lasting_.error_when_not_adopted = report.error_before;
    lasting_.costs.start_again(report.imbalance);
  }
  static_cast<Held&>(now_) = std::move(stepped.held);
  frame_.clear();
  now_.positions_step = report.step;
  now_.filled = true;
  now_.others = false;
  wants_positions_ = false;
  remember(report, std::move(stepped.sessions));
  return history_->last();
}

void Ledger::take(Rebalanced rebalanced) {
  now_.options = std::move(rebalanced.options);
  static_cast<Held&>(now_) = std::move(rebalanced.held);
  frame_.clear();
  lasting_.error_when_not_adopted.reset();
  lasting_.costs.start_again(now_.loads->imbalance);
  keep();
}

void Ledger::take(const Asked& asked) {
  ++totals_.asked[asked.command];
  asked_ = true;
}

void Ledger::remember(const StepReport& report, std::vector<std::uint64_t> sessions) {
  now_.step = report.step;
  ++totals_.steps;
  totals_.repartitions += report.repartitioned ? 1 : 0;
  totals_ += report;
  for (const std::string& name : report.skipped.names()) ++totals_.skipped[name];
  if (!std::exchange(asked_, false)) ++totals_.skipped["questions"];
  lasting_.last_sessions = std::move(sessions);
  lasting_.last_report = text_of(report);
  keep();
  history_->add(report, lasting_.last_report, journal_.get());
}

bool Ledger::was_in_last(const std::string& session, std::int64_t step) const {
  return step == now_.step && std::ranges::count(lasting_.last_sessions, session_key(session)) > 0;
}

Status Ledger::check_seat(const CountRecord& record) const {
  if (record.incarnation != now_.incarnation) return made_anew(name_);
  if (now_.step && record.step <= *now_.step) return stale_step(name_, record.step, *now_.step);
  return {};
}

Status Ledger::check(const CountRecord& record) const {
  if (Status status = check_seat(record); !status.ok() || !now_.step) return status;
  if (Status status = check_conserved(name_, now_.n, record.n, record.inserted, record.removed); !status.ok())
    return status;
  if (record.flows() && record.n > 0 && !record.id_sum)
    return {Code::invalid_argument, "particles come or go, and the count has no sum of ids",
            "without ids a row is its particle; give ids to all of them, and their sum in 'id_sum'"};
  if (!record.flows() && now_.id_sum && record.id_sum && *record.id_sum != *now_.id_sum)
    return {Code::not_conserved,
            fmt::format("the ids counted have the sum {}, those of the last step had {}", wire::hex64(*record.id_sum),
                        wire::hex64(*now_.id_sum)),
            "each particle is counted once, by its id; say how many come ('inserted') and go ('removed')"};
  if (record.n > 0 && now_.n > 0 && record.weights.has_value() != now_.weights)
    return {Code::invalid_argument,
            fmt::format("the count has {}weights, scene '{}' has {}", record.weights ? "" : "no ", name_,
                        now_.weights ? "some" : "none"),
            "weights are there from the first push on, or never"};
  return {};
}

std::optional<CountVerdict::Send> Ledger::always_sends() const {
  if (now_.options.parts <= (now_.weights ? kWeightedPartsMax : kPartsMax)) return std::nullopt;
  return CountVerdict::Send{"its parts are too many to be judged by one process"};
}

CountVerdict Ledger::count(const CountRecord& record) {
  if (Status status = check(record); !status.ok()) return {status};
  if (!now_.step) return {CountVerdict::Send{"first positions"}};
  if (now_.options.positions == Travel::every_step) return {CountVerdict::Send{"the scene's ranks hold every step"}};
  if (auto send = always_sends()) return {*std::move(send)};
  if (record.epoch != now_.epoch || record.hash != now_.hash) return {CountVerdict::OtherCuts{}};
  // Not before the cuts are known, since the push tells how many particles have drifted under them.
  if (!now_.positions_step) return {CountVerdict::Send{"the ranks hold no positions since the service was started"}};
  if (now_.n == 0 && record.n > 0) return {CountVerdict::Send{"the scene had no particles before"}};
  if (now_.n > 0 && record.n == 0) return {CountVerdict::Send{"no particles are left, so none travel"}};
  if (record.weights)
    if (const auto due = scale_due(*record.weights, record.n); due && *due != record.weights->scale)
      return {CountVerdict::OtherScale{*due}};
  auto loads = loads_of(record, now_.options.parts, now_.options.part_sizes);
  if (!loads.ok()) return {loads.status()};
  const Decision decision = decide_step(now_.options, *loads, terms(record.step_seconds));
  if (decision.search) return {CountVerdict::Send{decision.reason}};
  if (wants_positions_) return {CountVerdict::Send{"a question about positions waits"}};
  return commit(record, std::move(*loads), decision);
}

CountVerdict Ledger::commit(const CountRecord& record, partition::LoadSummary loads, const Decision& decision) {
  CountVerdict::Committed done{{}, now_.step};
  StepReport& report = done.report;
  report.scene = name_;
  report.step = record.step;
  report.epoch = now_.epoch;
  report.n = record.n;
  report.inserted = record.inserted;
  report.removed = record.removed;
  report.parts = now_.options.parts;
  report.error_before = report.error = loads.error;
  report.imbalance = loads.imbalance;
  report.reason = decision.reason;
  report.weights_as_zero = loads.weights_as_zero;
  report.way = Way::count;
  report.positions_step = now_.positions_step;
  report.drifted = record.drifted.value_or(0);
  report.drifted_known = record.drifted.has_value();
  report.bytes = record.bytes;
  if (now_.options.dims < 3) report.skipped.add(Skip::dimension);
  if (!now_.weights) report.skipped.add(Skip::weights);
  if (!now_.ids) report.skipped.add(Skip::ids);
  for (const Skip skip : {Skip::exchange, Skip::search, Skip::positions}) report.skipped.add(skip);
  if (record.step_seconds) lasting_.costs.computed(*record.step_seconds, now_.loads->imbalance);
  now_.loads = std::make_shared<const partition::LoadSummary>(std::move(loads));
  if (record.id_sum) now_.id_sum = record.id_sum;
  if (record.flows()) {
    now_.n = record.n;
    now_.others = true;
    frame_.clear();
  }
  report.strangers = record.strangers;
  remember(report, record.sessions);
  return {std::move(done)};
}

// On the thread for files, so that a disk that stands still holds up nobody.
void Ledgers::drop(const std::string& scene) {
  if (Ledger* ledger = find(scene))
    memory_->run_beside([storage = keeping_.storage, remove = ledger->drop()] { remove(); });
  ledgers_.erase(scene);
}

const StepReport* Ledgers::take(Change change, std::uint64_t incarnation) {
  if (auto* created = std::get_if<Created>(&change.event)) {
    drop(change.scene);
    std::unique_ptr<Journal> journal;
    std::string loss;
    if (keeping_.storage) {
      auto made = Journal::create(*keeping_.storage, keeping_.data_dir, {change.scene, incarnation});
      if (made.ok()) {
        journal = std::make_unique<Journal>(std::move(*made));
      } else {
        loss = made.status().message();
        spdlog::warn("scene '{}' will not outlive the service: {}", change.scene, loss);
      }
    }
    ledgers_.try_emplace(change.scene, change.scene, std::move(*created), incarnation, *memory_, std::move(journal),
                         std::move(loss));
  } else if (std::holds_alternative<Dropped>(change.event)) {
    drop(change.scene);
  } else if (Ledger* ledger = find(change.scene)) {
    if (auto* stepped = std::get_if<Stepped>(&change.event)) return &ledger->take(std::move(*stepped));
    if (auto* rebalanced = std::get_if<Rebalanced>(&change.event)) ledger->take(std::move(*rebalanced));
    if (const auto* asked = std::get_if<Asked>(&change.event)) ledger->take(*asked);
  }
  return nullptr;
}

Restored Ledgers::restore() {
  Restored restored;
  if (!keeping_.storage) return restored;
  const auto folders = scene_folders(*keeping_.storage, keeping_.data_dir);
  if (!folders.ok()) {
    spdlog::warn("no scenes of an earlier service are restored: {}", folders.status().message());
    return restored;
  }
  for (const SceneFolder& folder : *folders)
    if (const Status status = restore_one(folder); !status.ok())
      spdlog::warn("scene '{}' of an earlier service is not restored: {}", folder.name, status.message());
  for (const auto& [name, ledger] : ledgers_) {
    ++restored.scenes;
    restored.steps += ledger.totals().steps;
    restored.lost_records += ledger.totals().steps - ledger.journal()->reports();
  }
  return restored;
}

// Of two incarnations, which are left where the files of a scene that was replaced could not be removed, the later one
// goes on.
Status Ledgers::restore_one(const SceneFolder& folder) {
  JournalFound found;
  auto journal = Journal::open(*keeping_.storage, keeping_.data_dir, folder, found);
  if (!journal.ok()) return journal.status();
  for (const std::string& fault : found.faults) spdlog::warn("{}", fault);
  if (found.states.empty() && found.faults.empty())
    return remove_scene_folder(*keeping_.storage, folder.path(keeping_.data_dir));
  if (!found.states.empty() && found.states.front().empty()) return journal->remove();  // it was dropped
  Status why(Code::io_error, "its state is damaged");
  for (const std::string& state : found.states) {
    auto lasting = decode_lasting(state, folder.incarnation);
    if (!lasting.ok()) {
      why = lasting.status();
      continue;
    }
    SceneState& now = lasting->now;
    for (std::size_t k = 0; k < found.cuts.size() && !now.tree; ++k) {
      auto tree = decode_tree(found.cuts[k]);
      if (!tree.ok() || tree->hash() != now.hash) continue;
      if (k == 1) journal->hold_older_cuts();
      now.tree = std::make_shared<const cuts::CutTree>(std::move(*tree));
    }
    if (now.step && (!now.tree || now.tree->parts != now.options.parts || now.tree->dims != now.options.dims)) {
      why = {Code::io_error, "its cuts are damaged"};
      continue;
    }
    const std::uint64_t steps = lasting->totals.steps;
    if (const Status cut = journal->keep_below(steps); !cut.ok()) return cut;
    // The service died between the state and the report.
    if (steps > 0 && journal->next_report() < steps)
      if (const Status added = journal->append(steps - 1, lasting->last_report); !added.ok())
        spdlog::warn("{}", added.message());
    if (Ledger* other = find(folder.name)) {
      if (other->now().incarnation > folder.incarnation) return journal->remove();
      drop(folder.name);
    }
    ledgers_.try_emplace(folder.name, folder.name, std::move(*lasting), *memory_,
                         std::make_unique<Journal>(std::move(*journal)));
    return {};
  }
  return why;
}

Ledger* Ledgers::find(const std::string& scene) {
  const auto found = ledgers_.find(scene);
  return found == ledgers_.end() ? nullptr : &found->second;
}

const Ledger* Ledgers::find(const std::string& scene) const {
  const auto found = ledgers_.find(scene);
  return found == ledgers_.end() ? nullptr : &found->second;
}

}  // namespace rcb::scene
