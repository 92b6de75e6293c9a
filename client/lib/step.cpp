// Scene::step: check, push, mend what can be mended, and bring plan and parts up to date.
#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "client/lib/changes.hpp"
#include "client/lib/data_path.hpp"
#include "client/lib/push_source.hpp"
#include "client/lib/scene.hpp"
#include "client/lib/step_report.hpp"
#include "common/wire/limits.hpp"

namespace rcb::client {
namespace {

constexpr std::int64_t kStepMax = std::numeric_limits<std::int64_t>::max();

constexpr const char* kAxisNames[] = {"x", "y", "z"};

wire::Json plan_json(const plan::Plan& plan) {
  return {{"version", plan.version()}, {"checksum", wire::hex64(plan.checksum())}};
}

// Those that are new have a part for the first time.
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

Status Scene::State::wrong(std::string message, std::string hint) const {
  return {Code::invalid_argument, fmt::format("push to scene '{}': {}", name_, message), std::move(hint)};
}

Status Scene::State::check_positions(const Ask& ask) const {
  const Positions& positions = ask.positions;
  if (positions.dims != dims_)
    return wrong(fmt::format("positions of {} dimensions, the scene has {}", positions.dims, dims_),
                 "create the scene with the positions' dims");
  if (positions.in_plan_order() && !pushed_)
    return wrong("positions in the plan's order, and there is no plan yet", "push a first step by rows or axes");
  for (std::size_t a = 0; a < static_cast<std::size_t>(dims_); ++a)
    if (positions.count > 0 && !positions.in_plan_order() &&
        (positions.single() ? positions.axis_f4[a] == nullptr : positions.axis[a] == nullptr))
      return wrong(fmt::format("no array for axis {}", kAxisNames[a]), "give one array an axis");
  if (positions.stride == 0) return wrong("a stride of 0", "a stride is at least 1");
  if (positions.count > static_cast<std::uint64_t>(wire::kParticlesMax))
    return wrong(fmt::format("{} particles", positions.count),
                 fmt::format("at most {} are taken", wire::kParticlesMax));
  if (pushed_ && ask.whole() && positions.count != count_)
    return wrong(fmt::format("{} particles, the scene has {}", positions.count, count_),
                 "push all particles of the scene, with those to insert or remove beside them, or create it anew with "
                 "replace");
  if (ask.moved == Ask::Moved::ids && positions.count != ask.ids.size())
    return wrong(fmt::format("{} positions of {} moved particles", positions.count, ask.ids.size()),
                 "give one position an id");
  if (ask.moved != Ask::Moved::all && positions.in_plan_order())
    return wrong("few particles of positions in the plan's order", "give rows or axes");
  return {};
}

Status Scene::State::check(const Ask& ask) const {
  const Positions& positions = ask.positions;
  const StepOptions& options = ask.options;
  if (Status status = check_positions(ask); !status) return status;
  if (ask.whole() && !options.ids.empty() && options.ids.size() != positions.count)
    return wrong(fmt::format("{} ids for {} particles", options.ids.size(), positions.count), "give one id a particle");
  if (!options.weights.empty() && ask.moved != Ask::Moved::all)
    return wrong("new weights in a push of few particles", "push all particles with their weights");
  if (!options.weights.empty() && options.weights.size() != positions.count)
    return wrong(fmt::format("{} weights for {} particles", options.weights.size(), positions.count),
                 "give one weight a particle, or none");
  if (pushed_ && !options.weights.empty() && !has_weights_)
    return wrong("weights, and the scene has none", "weights must be there from the first push on");
  if ((told_ || !ids_.empty()) && ask.whole() && !options.ids.empty())
    for (std::size_t row = 0; row < options.ids.size(); ++row)
      if (const std::int64_t known = ids_.empty() ? static_cast<std::int64_t>(row) : ids_[row];
          options.ids[row] != known)
        return wrong(fmt::format("row {} has id {}, at first it had {}", row, options.ids[row], known),
                     "ids belong to rows, which insertions and removals alone change; leave them out after the first "
                     "push");
  if (pushed_ && has_ids_ && ids_.empty() && options.ids.empty() && count_ > 0 && ask.whole())
    return wrong("the scene has ids of its own, and the push gives none",
                 "say whose positions these are: a column \"id\" in a file, StepOptions::ids in a program");
  if (options.step && *options.step < 0)
    return wrong(fmt::format("step {}", *options.step), "steps are numbered from 0");
  if (options.step_seconds && !(*options.step_seconds >= 0 && std::isfinite(*options.step_seconds)))
    return wrong(fmt::format("a step of {} seconds", *options.step_seconds), "give a finite number >= 0, or none");
  if (!(options.deadline_seconds > 0))
    return wrong(fmt::format("a deadline of {} seconds", options.deadline_seconds), "give a number above 0");
  return check_edits(ask);
}

Status Scene::State::ready(std::uint64_t count, std::span<const std::int64_t> ids, const Deadline& deadline,
                           bool with_plan) {
  if (Status status = session().ensure(deadline); !status) return status;
  if (generation_ != session().generation())
    if (Status status = open_again(deadline); !status) return status;
  if (!pushed_) {
    plan_ = plan::Plan::blocks(count, session().ranks(), ids);
    return {};
  }
  if (plan_ && plan_->ranks() != session().ranks()) plan_.reset();  // started again on other ranks
  return plan_ || !with_plan ? Status{} : fetch_plan(ids_by_row(ids), deadline);
}

std::span<const std::int64_t> Scene::State::ids_by_row(std::span<const std::int64_t> given) const {
  return ids_.empty() ? given : std::span<const std::int64_t>(ids_);
}

Result<Frame> Scene::State::push(const Ask& ask, std::int64_t step, std::optional<std::int64_t> base,
                                 const Deadline& deadline) {
  const Positions& positions = ask.positions;
  const StepOptions& options = ask.options;
  const bool all = ask.moved == Ask::Moved::all;
  const bool send_ids = !pushed_ && !options.ids.empty();
  if (Status status = plan_ ? check_plan_order(positions) : Status(); !status) return status;
  Selection few;
  if (ask.moved == Ask::Moved::rows || ask.moved == Ask::Moved::ids) {
    auto selected = select(ask);
    if (!selected) return selected.status();
    few = std::move(*selected);
  }
  const auto none = [](const auto& rank) { return rank.empty(); };
  const bool some = !all && !std::all_of(few.slots.begin(), few.slots.end(), none);
  const bool alone = positions.count == 0 && ask.inserted() > 0;
  const bool single = alone ? options.inserted->positions.single() : positions.single();
  wire::Json begin{{"scene", name_},
                   {"session", session().number()},
                   {"step", step},
                   {"attempt", session().next_attempt()},
                   {"n", pushed_ ? count_ : positions.count},
                   {"order", "plan"},
                   {"plan", plan_ ? plan_json(*plan_) : wire::Json()},
                   {"base_step", all || !base ? wire::Json() : wire::Json(*base)},
                   {"moved", all    ? "all"
                             : some ? "some"
                                    : "none"},
                   {"dtype", single ? "<f4" : "<f8"},
                   {"weights", !options.weights.empty()},
                   {"ids", send_ids},
                   {"changes", true},
                   {"deadline_seconds", std::clamp(options.deadline_seconds, 0.001, wire::kDeadlineSecondsMax)}};
  if (options.step_seconds) begin["step_seconds"] = *options.step_seconds;
  // One pointer a rank: to the axes' elements, or to the slots.
  std::array<std::vector<const void*>, 4> by_rank;
  std::vector<Column> columns;
  for (std::size_t a = 0; a < static_cast<std::size_t>(dims_); ++a) {
    for (const auto& axes : positions.by_rank) by_rank[a].push_back(axes[a]);
    for (const auto& axes : positions.by_rank_f4) by_rank[a].push_back(axes[a]);
    columns.push_back(axis_column(positions, a, by_rank[a].empty() ? nullptr : by_rank[a].data()));
  }
  if (!options.weights.empty()) columns.push_back({"w", "<f8", options.weights.data(), 1});
  if (send_ids) columns.push_back({"id", "<i8", options.ids.data(), 1});
  RankRows rows;
  if (all) {
    rows = all_rows(*plan_);
  } else if (some) {
    begin["counts"] = wire::Json::array();
    for (std::size_t rank = 0; rank < few.slots.size(); ++rank) {
      begin["counts"].push_back(few.slots[rank].size());
      rows.emplace_back(few.places[rank]);
      by_rank[3].push_back(few.slots[rank].data());
    }
    columns.push_back({"slot", "<u8", nullptr, 1, by_rank[3].data()});
  }
  return send(std::move(begin), rows, std::move(columns), ask,
              fmt::format("push of step {} to scene '{}'", step, name_), deadline);
}

Result<Frame> Scene::State::send(wire::Json begin, const RankRows& rows, std::vector<Column> columns, const Ask& ask,
                                 const std::string& what, const Deadline& deadline) {
  const std::uint64_t request = session().next_request();
  begin["inserted"] = ask.inserted();
  begin["removed"] = ask.options.removed.size();
  begin["inserted_ids"] = ask.inserted() > 0 && !ask.options.inserted->ids.empty();
  const EditFrames edits = edit_frames(begin, request, ask, dims_);
  std::size_t particles = 0;
  for (const auto& of_rank : rows) particles += of_rank.size();
  const bool large = particles * particle_bytes(columns) >= kDirectBytesMin;
  const Path path = session().path();
  if (particles > 0 && (path == Path::direct || (path == Path::automatic && large))) {
    if (session().data(deadline) != nullptr) {
      wire::Json slice{{"command", "push.slice"}};
      for (const char* name : {"scene", "session", "step", "attempt", "plan"}) slice[name] = begin.at(name);
      begin["command"] = "push.begin";
      begin["path"] = "direct";
      begin["slices"] = edits.count;
      wire::FrameHeader header;
      header.request = request;
      const std::string frames = wire::encode_frame(header, wire::dump_json(begin)) + edits.bytes;
      return session().exchange_directly(request, frames, slice, rows, columns, what, deadline);
    }
    if (path == Path::direct)
      return Status(Code::unavailable, fmt::format("{} has no direct path to its ranks", session().endpoint()),
                    "leave the path to the library, or start the service without --gateway-only");
  }
  PushSource source(begin, request, rows, std::move(columns), edits.bytes, edits.count);
  return session().exchange(request, source, what, deadline);
}

// Positions in the plan's order must follow the plan that is pushed by.
Status Scene::State::check_plan_order(const Positions& positions) const {
  if (!positions.in_plan_order()) return {};
  const std::string hint = "ask Scene::plan() and put the positions into its order";
  if (positions.plan_version != plan_->version())
    return {Code::stale_plan,
            fmt::format("push to scene '{}': positions in the order of plan {}, it is {}", name_,
                        positions.plan_version, plan_->version()),
            hint};
  const std::size_t ranks = std::max(positions.by_rank.size(), positions.by_rank_f4.size());
  if (ranks != static_cast<std::size_t>(plan_->ranks()))
    return {Code::invalid_argument, fmt::format("positions of {} ranks, there are {}", ranks, plan_->ranks()), hint};
  const auto missing = [&positions](std::size_t rank, std::size_t a) {
    return positions.single() ? positions.by_rank_f4[rank][a] == nullptr : positions.by_rank[rank][a] == nullptr;
  };
  for (std::size_t rank = 0; rank < ranks; ++rank)
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims_); ++a)
      if (missing(rank, a) && !plan_->rows(static_cast<int>(rank)).empty())
        return {Code::invalid_argument, fmt::format("no array for axis {} of rank {}", kAxisNames[a], rank), hint};
  return {};
}

Result<StepResult> Scene::State::step(Ask ask) {
  if (Status status = check(ask); !status) return status;
  const StepOptions& options = ask.options;
  if (!options.step && last_step_ && *last_step_ == std::numeric_limits<std::int64_t>::max())
    return Status(Code::invalid_argument, "there is no step number left");
  if (!pushed_ && !ask.whole())
    return Status(Code::base_lost, fmt::format("push to scene '{}': it has no positions yet", name_),
                  "push all positions with step()");
  const std::int64_t step = options.step.value_or(last_step_ ? *last_step_ + 1 : 0);
  const std::optional<std::int64_t> base = last_step_;
  if (!base) ask.moved = Ask::Moved::all;
  count_if_committed_ = count_ + ask.inserted() - options.removed.size();
  const Deadline deadline(with_margin(std::min(options.deadline_seconds, wire::kDeadlineSecondsMax)));
  bool plan_mended = false;
  bool connection_mended = false;
  bool data_mended = false;
  for (;;) {
    const bool with_plan = ask.moved != Ask::Moved::none || ask.edits();
    Status status = ready(pushed_ ? count_ : ask.positions.count, options.ids, deadline, with_plan);
    if (status) {
      const auto answer = push(ask, step, base, deadline);
      if (answer) return finish(*answer, step, ask, deadline);
      status = answer.status();
    }
    const bool lost = status.code() == Code::unavailable && !session().connected();
    // A rank's connection went, and the push with it: once more, another way where the caller leaves the choice.
    if (status.code() == Code::aborted && session().data_lost() && !data_mended) {
      data_mended = true;
      continue;
    }
    if (status.code() == Code::base_lost && ask.moved == Ask::Moved::rows) {
      ask.moved = Ask::Moved::all;
      continue;
    }
    if (status.code() == Code::stale_plan && !plan_mended) {
      plan_mended = true;
      plan_.reset();
      if (pushed_) continue;
      // Another client pushed first.
      if (Status opened = open(deadline.left_seconds()); !opened) return opened;
      if (Status fits = check(ask); !fits) return fits;
      continue;
    }
    if (!lost || connection_mended) return status;
    connection_mended = true;
  }
}

// The step is committed: whatever happens here, it stands.
Result<StepResult> Scene::State::finish(const Frame& answer, std::int64_t step, const Ask& ask,
                                        const Deadline& deadline) {
  const StepOptions& options = ask.options;
  const auto json = answer.json();
  if (!json) return json.status();
  const auto found = json->find("report");
  if (found == json->end()) return Status(Code::protocol_error, "answer to a push: no 'report'");
  auto report = read_report(*found);
  if (!report) return report.status();
  const bool first = !pushed_;
  if (first) {
    has_weights_ = !options.weights.empty();
    has_ids_ = !options.ids.empty();
    ids_.assign(options.ids.begin(), options.ids.end());
    count_ = ask.positions.count;
    pushed_ = true;
  }
  // Another session's step in between may have changed parts without changing the plan.
  const auto before = wire::integer_field_or(*json, "previous_step", 0, kStepMax, last_step_.value_or(-1));
  const bool step_follows = first || (before && *before == last_step_.value_or(-1));
  last_step_ = std::max(step, last_step_.value_or(step));

  const auto repeated = wire::bool_field_or(*json, "repeated", false);
  const bool epoch_follows = first || report->epoch == epoch_ + (report->repartitioned ? 1U : 0U);
  epoch_ = report->epoch;
  StepResult result;
  const bool follows = !(repeated && *repeated) && epoch_follows && step_follows;
  RowEdit edit;
  if (ask.edits()) {
    auto found_rows = row_edit(ask);
    if (!found_rows) return found_rows.status();
    edit = std::move(*found_rows);
    if (ids_.empty()) ids_.assign(options.ids.begin(), options.ids.end());
    edit_rows(ask, edit, *report, answer, follows, result);
  }
  Status current;
  const bool asked = options.want_parts || options.want_changes;
  if (!plan_ && !asked && !ask.edits()) {
    // Fetched when it is needed.
  } else if (!follows || !plan_ || !apply(answer, *json, first, result.changes)) {
    current = fetch_plan(ask.edits() ? std::span<const std::int64_t>(ids_) : ids_by_row(options.ids), deadline);
  }
  if (current && plan_ && parts_.size() == count_)
    for (const plan::SlotMove& move : edit.moves.moves)
      if (move.arrival && parts_[move.to] < 0) parts_[move.to] = edit.inserted_part[move.from];
  if (!current) {
    // Fetched again before the next push.
    plan_.reset();
    if (asked)
      return Status(current.code(),
                    fmt::format("step {} is committed, but its parts are not known: {}", step, current.message()),
                    current.hint());
  }
  if (!current || !options.want_changes)
    result.changes.clear();
  else if (!told_)
    result.changes = all_parts();
  else if (!known_.empty())
    result.changes = changes_since_known();
  else if (ask.edits())
    add_inserted(result, parts_);
  if (current && plan_) {
    told_ = true;
    known_.clear();
    if (options.want_parts) result.parts = parts_;
  }
  result.report = std::move(*report);
  return result;
}

// Brings plan_ and parts_ up to date from the answer alone. A failure leaves parts_ as it was, and plan_ unusable.
Status Scene::State::apply(const Frame& answer, const wire::Json& json, bool first, std::vector<PartChange>& changes) {
  const Status odd(Code::protocol_error, "answer to a push: its changes don't lead to its plan");
  const wire::Array* id = wire::find_array(answer.arrays, "changed_id");
  const wire::Array* part = wire::find_array(answer.arrays, "changed_part");
  if (id == nullptr || part == nullptr || id->dtype != "<i8" || part->dtype != "<i4") return odd;
  const std::size_t count = id->bytes.size() / 8;
  if (part->bytes.size() / 4 != count || count > count_ || (first && count != count_)) return odd;
  const auto* ids = reinterpret_cast<const std::int64_t*>(id->bytes.data());
  const auto* new_parts = reinterpret_cast<const std::int32_t*>(part->bytes.data());
  std::vector<std::uint64_t> rows(count);
  std::vector<std::int32_t> ranks(count);
  for (std::size_t i = 0; i < count; ++i) {
    const auto row = plan_->row_of_id(ids[i]);
    if (i > 0 && ids[i] <= ids[i - 1]) return odd;
    if (!row || new_parts[i] < 0 || new_parts[i] >= parts_count_) return odd;
    rows[i] = *row;
    ranks[i] = plan::rank_of_part(new_parts[i], parts_count_, plan_->ranks());
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

std::vector<PartChange> Scene::State::all_parts() const {
  std::vector<PartChange> changes(parts_.size());
  for (std::size_t row = 0; row < parts_.size(); ++row) changes[row] = {row, parts_[row]};
  return changes;
}

std::vector<PartChange> Scene::State::changes_since_known() const {
  std::vector<PartChange> changes;
  for (std::size_t row = 0; row < parts_.size(); ++row)
    if (row >= known_.size() || known_[row] != parts_[row]) changes.push_back({row, parts_[row]});
  return changes;
}

}  // namespace rcb::client
