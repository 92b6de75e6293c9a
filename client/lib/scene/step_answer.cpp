// Scene::step after the commit: updates layout and parts, and collects the changes for the caller.
#include <algorithm>
#include <limits>
#include <numeric>

#include <fmt/format.h>

#include "client/lib/scene/changes.hpp"
#include "client/lib/scene/scene.hpp"
#include "client/lib/scene/step_report.hpp"

namespace rcb::client {
namespace {

std::vector<PartChange> differences(std::span<const std::int32_t> before, std::span<const std::int32_t> now) {
  std::vector<PartChange> changes;
  for (std::size_t row = 0; row < now.size(); ++row)
    if (row >= before.size() || before[row] != now[row]) changes.push_back({row, now[row]});
  return changes;
}

constexpr std::int64_t kStepMax = std::numeric_limits<std::int64_t>::max();

// Inserted particles have a part for the first time, so each counts as changed.
void add_inserted(StepResult& result, std::span<const std::int32_t> parts) {
  std::vector<std::uint64_t> rows;
  for (const RowMove& move : result.row_moves)
    if (move.inserted) rows.push_back(move.to);
  std::sort(rows.begin(), rows.end());
  std::erase_if(result.changes,
                [&rows](const PartChange& change) { return std::binary_search(rows.begin(), rows.end(), change.row); });
  for (const std::uint64_t row : rows) result.changes.push_back({row, parts[row]});
  std::sort(result.changes.begin(), result.changes.end(),
            [](const PartChange& a, const PartChange& b) { return a.row < b.row; });
}

}  // namespace

void Scene::State::take_first(const StepRequest& ask) {
  const StepOptions& options = ask.options;
  has_weights_ = !options.weights.empty();
  has_ids_ = !options.ids.empty();
  if (options.ids.empty() || options.ids.data() != ids_.data()) ids_.assign(options.ids.begin(), options.ids.end());
  rows_assumed_ = false;
  count_ = ask.positions.count;
  pushed_ = began_ = true;
}

Result<Scene::State::Answer> Scene::State::read_answer(const Frame& frame, std::int64_t step, bool tried_before) const {
  const auto json = frame.json();
  if (!json) return json.status();
  const auto found = json->find("report");
  if (found == json->end()) return Status(Code::protocol_error, "answer to a push: no 'report'");
  auto report = read_report(*found);
  if (!report) return report.status();
  if (report->parts == 0) report->parts = parts_count_;
  const auto said = wire::bool_field(*json, "repeated");
  const bool repeated = said && *said;
  if (repeated && !tried_before)
    return Status(Code::stale_step,
                  fmt::format("step {} of scene '{}' was pushed by another Scene of this client", step, name_),
                  "use one Scene for each scene of a client");
  const bool first = !pushed_;
  // A step in between that this Scene knows nothing of may have changed parts without changing the layout.
  const auto before = wire::integer_field_or(*json, "previous_step", 0, kStepMax, last_step_.value_or(-1));
  const bool step_follows = first || (!missed_ && before && *before == last_step_.value_or(-1));
  const bool epoch_follows = first || report->epoch == epoch_ + (report->repartitioned ? 1U : 0U);
  const bool follows = !repeated && epoch_follows && step_follows && report->parts == parts_count_;
  return Answer{*json, std::move(*report), first, repeated, epoch_follows, follows, false, {}, {}, {}};
}

Status Scene::State::complete_answer(const Frame& frame, const StepRequest& ask, const Retry& retry, Answer& answer) {
  if (uses_cuts(ask)) {
    auto after = cuts_.after_step(frame, answer.json, session(), name_, retry);
    if (!after) return after.status();
    answer.cuts = std::move(*after);
  }
  if (can_count(ask)) {  // its drift is told already
    if (Status status = counted_.count(*answer.cuts, rows_of(ask), std::nullopt); !status) return status;
    answer.counted = true;
  } else if (when_needed_ && ask.moved == StepRequest::Moved::none && !ask.edits()) {
    answer.counted = counted_.holds(last_step_, *answer.cuts);
  }
  if (ask.wants() && answer.counted) {
    answer.parts.emplace(counted_.parts().begin(), counted_.parts().end());
  } else if (ask.wants_by_cuts()) {
    answer.parts.emplace(ask.positions.count);
    cuts::OwnerOptions options{.ids = ids_of_rows(ask), .threads = std::max(ask.options.threads, scene_.threads)};
    if (parts_.size() == answer.parts->size()) options.last_part = parts_;
    return answer.cuts->owner(ask.positions, options, *answer.parts);
  }
  if (!ask.wants() || answer.parts || (answer.follows && plan_)) return {};
  if (ask.whole()) return parts_by_cuts(frame, ask, retry, answer);
  auto told = ask_plan(retry);
  if (told) answer.plan = std::move(*told);
  return told.status();
}

Status Scene::State::parts_by_cuts(const Frame& frame, const StepRequest& ask, const Retry& retry,
                                   Answer& answer) const {
  auto after = cuts_.after_step(frame, answer.json, session(), name_, retry);
  if (!after) return after.status();
  const int threads = std::max(ask.options.threads, scene_.threads);
  answer.parts.emplace(ask.positions.count);
  if (Status status =
          after->owner(ask.positions, {.ids = ids_by_row(ask.options.ids), .threads = threads}, *answer.parts);
      !status || ask.inserted() == 0)
    return status;
  const Insertion& in = *ask.options.inserted;
  std::vector<std::int64_t> ids(in.ids.begin(), in.ids.end());
  if (ids.empty()) ids.resize(ask.inserted());
  if (in.ids.empty()) std::iota(ids.begin(), ids.end(), answer.report.first_id.value_or(0));
  answer.inserted_part.resize(ask.inserted());
  return after->owner(in.positions, {.ids = ids, .threads = threads}, answer.inserted_part);
}

// The step is committed: an error here doesn't undo it.
Result<Scene::State::Committed> Scene::State::finish(const Frame& frame, Answer answer, const StepRequest& ask) {
  const StepOptions& options = ask.options;
  StepReport& report = answer.report;
  // If the answer to the first push was lost, the scene is found with its particles; which rows they are is known here
  // alone.
  if (answer.first || (first_ && answer.repeated)) take_first(ask);
  if (!options.weights.empty()) keep_weights(options.weights);
  last_step_ = std::max(report.step, last_step_.value_or(report.step));
  missed_ = base_unknown_ = false;
  answered_ = true;
  epoch_ = report.epoch;
  older_ = !report.sent;
  Committed done;
  parts_count_ = report.parts;
  if (answer.cuts) cuts_.known = std::move(answer.cuts);
  if (answer.counted)
    counted_.committed(report.step);
  else
    counted_.forget();
  const bool by_cuts = answer.parts.has_value();
  if (by_cuts && !ask.edits()) done.result.changes = differences(parts_told(), *answer.parts);
  if (!report.sent) plan_.reset();  // it is that of an older step; parts_ go on
  const bool asked = ask.wants();
  if (plan_ && !asked && told_ && !known_) known_ = parts_;
  if (ask.edits()) {
    auto found_rows = row_edit(ask);
    if (!found_rows) return found_rows.status();
    done.edit = std::move(*found_rows);
    if (ids_.empty()) ids_.assign(options.ids.begin(), options.ids.end());
    if (by_cuts) {
      if (!known_) known_ = std::move(parts_);
      parts_ = std::move(*answer.parts);
    }
    edit_rows(ask, done.edit, report, frame, answer.follows, done.result);
    if (by_cuts)
      for (const layout::SlotMove& move : done.edit.moves.moves)
        if (move.arrival) parts_[move.to] = answer.inserted_part[move.from];
  }
  // Without a layout and where nothing is asked, it is fetched when it is needed.
  std::vector<PartChange> changes;
  if (report.sent && (plan_ || (asked && !by_cuts)))
    done.plan_needed = !answer.follows || !plan_ || !apply(frame, answer.json, answer.first, changes);
  if (done.plan_needed) plan_.reset();
  if (by_cuts && !ask.edits()) {
    parts_ = std::move(*answer.parts);
    known_.reset();
    told_ = true;
  }
  if (by_cuts) {
    done.plan_needed = false;
  } else {
    done.result.changes = std::move(changes);
  }
  if (done.plan_needed && answer.plan) {
    if (Status status = take_plan(*answer.plan, ids_of_rows(ask)); !status) return status;
    done.plan_needed = false;
  }
  done.result.report = std::move(report);
  return done;
}

std::span<const std::int64_t> Scene::State::ids_of_rows(const StepRequest& ask) const {
  return ask.edits() ? std::span<const std::int64_t>(ids_) : ids_by_row(ask.options.ids);
}

Status Scene::State::fetch_plan_of_step(const StepRequest& ask, Retry& retry) {
  return session().retry_until_deadline(retry, [&]() -> Status {
    if (Status status = hold(retry); !status) return status;
    return filled_ ? fetch_plan(ids_of_rows(ask), retry) : base_lost("their parts are told after the next step");
  });
}

Result<StepResult> Scene::State::complete(const StepRequest& ask, Committed done, Retry& retry) {
  const StepOptions& options = ask.options;
  StepResult& result = done.result;
  const bool asked = ask.wants();
  if (asked && done.plan_needed)
    if (Status status = fetch_plan_of_step(ask, retry); !status) return parts_unknown(result.report.step, status);
  if (plan_ && parts_.size() == count_)
    for (const layout::SlotMove& move : done.edit.moves.moves)
      if (move.arrival && parts_[move.to] < 0) parts_[move.to] = done.edit.inserted_part[move.from];
  if (!asked) {
    result.changes.clear();
    return result;
  }
  if (!options.want_changes)
    result.changes.clear();
  else if (!told_)
    result.changes = differences({}, parts_);
  else if (known_)
    result.changes = differences(*known_, parts_);
  else if (ask.edits())
    add_inserted(result, parts_);
  told_ = true;
  known_.reset();
  if (options.want_parts) result.parts = parts_;
  return result;
}

// Updates plan_ and parts_ from the answer alone. If that fails, parts_ is unchanged, and plan_ unusable.
Status Scene::State::apply(const Frame& answer, const wire::Json& json, bool first, std::vector<PartChange>& changes) {
  const Status odd(Code::protocol_error, "answer to a push: its changes don't lead to its plan");
  const auto changed_id = answer.array<std::int64_t>("changed_id");
  const auto changed_part = answer.array<std::int32_t>("changed_part");
  if (!changed_id || !changed_part || changed_id->size() != changed_part->size()) return odd;
  const auto ids = *changed_id;
  const auto new_parts = *changed_part;
  const std::size_t count = ids.size();
  if (count > count_ || (first && count != count_)) return odd;
  std::vector<std::uint64_t> rows(count);
  std::vector<std::int32_t> ranks(count);
  for (std::size_t i = 0; i < count; ++i) {
    const auto row = plan_->row_of_id(ids[i]);
    if (i > 0 && ids[i] <= ids[i - 1]) return odd;
    if (!row || new_parts[i] < 0 || new_parts[i] >= parts_count_) return odd;
    rows[i] = *row;
    ranks[i] = layout::rank_of_part(new_parts[i], parts_count_, plan_->ranks());
  }
  if (Status status = plan_->apply(rows, ranks, first); !status) return status;
  const auto named = json.find("plan");
  if (named == json.end()) return odd;
  const auto version = wire::integer_field(*named, "version", 0, std::numeric_limits<std::int64_t>::max());
  const auto checksum = wire::string_field(*named, "checksum", 16);
  if (!version || static_cast<std::uint64_t>(*version) != plan_->version() || !checksum ||
      *checksum != wire::hex64(plan_->checksum()))
    return odd;
  if (first) parts_.assign(count_, -1);
  changes.resize(count);
  for (std::size_t i = 0; i < count; ++i) {
    parts_[rows[i]] = new_parts[i];
    changes[i] = {rows[i], new_parts[i]};
  }
  const auto by_row = [](const PartChange& a, const PartChange& b) { return a.row < b.row; };
  if (!std::is_sorted(changes.begin(), changes.end(), by_row)) std::sort(changes.begin(), changes.end(), by_row);
  return {};
}

}  // namespace rcb::client
