// Scene::step: check, push, mend what can be mended, and bring plan and parts up to date.
#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "client/lib/data_path.hpp"
#include "client/lib/push_source.hpp"
#include "client/lib/scene.hpp"
#include "client/lib/step_report.hpp"
#include "common/wire/limits.hpp"

namespace rcb::client {
namespace {

constexpr std::int64_t kStepMax = std::numeric_limits<std::int64_t>::max();

// Smaller pushes are one write to the endpoint; the ranks need not be told of them.
constexpr std::size_t kDirectBytesMin = std::size_t{1} << 18U;

constexpr const char* kAxisNames[] = {"x", "y", "z"};

wire::Json plan_json(const plan::Plan& plan) {
  return {{"version", plan.version()}, {"checksum", wire::hex64(plan.checksum())}};
}

}  // namespace

Status Scene::State::check(const Positions& positions, const StepOptions& options) const {
  const auto wrong = [this](std::string message, std::string hint) {
    return Status(Code::invalid_argument, fmt::format("push to scene '{}': {}", name_, message), std::move(hint));
  };
  if (positions.dims != dims_)
    return wrong(fmt::format("positions of {} dimensions, the scene has {}", positions.dims, dims_),
                 "create the scene with the positions' dims");
  if (!positions.by_rank.empty() && !pushed_)
    return wrong("positions in the plan's order, and there is no plan yet", "push a first step by rows or axes");
  for (std::size_t a = 0; a < static_cast<std::size_t>(dims_); ++a)
    if (positions.count > 0 && positions.axis[a] == nullptr && positions.by_rank.empty())
      return wrong(fmt::format("no array for axis {}", kAxisNames[a]), "give one array an axis");
  if (positions.stride == 0) return wrong("a stride of 0", "a stride is at least 1");
  if (positions.count > static_cast<std::uint64_t>(wire::kParticlesMax))
    return wrong(fmt::format("{} particles", positions.count),
                 fmt::format("at most {} are taken", wire::kParticlesMax));
  if (pushed_ && positions.count != count_)
    return wrong(fmt::format("{} particles, the scene has {}", positions.count, count_),
                 "push all particles of the scene, or create it anew with replace");
  if (!options.ids.empty() && options.ids.size() != positions.count)
    return wrong(fmt::format("{} ids for {} particles", options.ids.size(), positions.count), "give one id a particle");
  if (!options.weights.empty() && options.weights.size() != positions.count)
    return wrong(fmt::format("{} weights for {} particles", options.weights.size(), positions.count),
                 "give one weight a particle, or none");
  if (pushed_ && !options.weights.empty() && !has_weights_)
    return wrong("weights, and the scene has none", "weights must be there from the first push on");
  if (told_ && !options.ids.empty())
    for (std::size_t row = 0; row < options.ids.size(); ++row)
      if (const std::int64_t known = ids_.empty() ? static_cast<std::int64_t>(row) : ids_[row];
          options.ids[row] != known)
        return wrong(fmt::format("row {} has id {}, at first it had {}", row, options.ids[row], known),
                     "ids belong to rows once and for all; leave them out after the first push");
  if (pushed_ && has_ids_ && ids_.empty() && options.ids.empty() && positions.count > 0)
    return wrong("the scene has ids of its own, and the push gives none", "give StepOptions::ids at the first step");
  if (options.step && *options.step < 0)
    return wrong(fmt::format("step {}", *options.step), "steps are numbered from 0");
  if (options.step_seconds && !(*options.step_seconds >= 0 && std::isfinite(*options.step_seconds)))
    return wrong(fmt::format("a step of {} seconds", *options.step_seconds), "give a finite number >= 0, or none");
  if (!(options.deadline_seconds > 0))
    return wrong(fmt::format("a deadline of {} seconds", options.deadline_seconds), "give a number above 0");
  return {};
}

Status Scene::State::ready(std::uint64_t count, std::span<const std::int64_t> ids, const Deadline& deadline) {
  if (Status status = session().ensure(deadline); !status) return status;
  if (generation_ != session().generation())
    if (Status status = open_again(deadline); !status) return status;
  if (!pushed_) {
    plan_ = plan::Plan::blocks(count, session().ranks(), ids);
    return {};
  }
  if (plan_ && plan_->ranks() != session().ranks()) plan_.reset();  // started again on other ranks
  return plan_ ? Status{} : fetch_plan(ids_by_row(ids), deadline);
}

std::span<const std::int64_t> Scene::State::ids_by_row(std::span<const std::int64_t> given) const {
  return ids_.empty() ? given : std::span<const std::int64_t>(ids_);
}

Result<Frame> Scene::State::push(const Positions& positions, const StepOptions& options, std::int64_t step,
                                 const Deadline& deadline) {
  const bool send_ids = !pushed_ && !options.ids.empty();
  wire::Json begin{{"scene", name_},
                   {"session", session().number()},
                   {"step", step},
                   {"attempt", ++attempt_},
                   {"n", positions.count},
                   {"order", "plan"},
                   {"plan", plan_json(*plan_)},
                   {"base_step", nullptr},
                   {"weights", !options.weights.empty()},
                   {"ids", send_ids},
                   {"changes", true},
                   {"deadline_seconds", std::clamp(options.deadline_seconds, 0.001, wire::kDeadlineSecondsMax)}};
  if (options.step_seconds) begin["step_seconds"] = *options.step_seconds;
  if (Status status = check_plan_order(positions); !status) return status;
  std::array<std::vector<const double*>, 3> by_rank;
  std::vector<Column> columns;
  for (std::size_t a = 0; a < static_cast<std::size_t>(dims_); ++a) {
    for (const auto& axes : positions.by_rank) by_rank[a].push_back(axes[a]);
    columns.push_back(
        {kAxisNames[a], "<f8", positions.axis[a], positions.stride, by_rank[a].empty() ? nullptr : by_rank[a].data()});
  }
  if (!options.weights.empty()) columns.push_back({"w", "<f8", options.weights.data(), 1});
  if (send_ids) columns.push_back({"id", "<i8", options.ids.data(), 1});
  const std::uint64_t request = session().next_request();
  const std::string what = fmt::format("push of step {} to scene '{}'", step, name_);
  const bool large = positions.count * columns.size() * sizeof(double) >= kDirectBytesMin;
  const Path path = session().path();
  if (path == Path::direct || (path == Path::automatic && large)) {
    if (session().data(deadline) != nullptr) {
      wire::Json slice{{"command", "push.slice"}};
      for (const char* name : {"scene", "session", "step", "attempt", "plan"}) slice[name] = begin.at(name);
      begin["command"] = "push.begin";
      begin["path"] = "direct";
      begin["slices"] = 0;
      return session().exchange_directly(request, begin, slice, *plan_, columns, what, deadline);
    }
    if (path == Path::direct)
      return Status(Code::unavailable, fmt::format("{} has no direct path to its ranks", session().endpoint()),
                    "leave the path to the library, or start the service without --gateway-only");
  }
  PushSource source(begin, request, *plan_, std::move(columns));
  return session().exchange(request, source, what, deadline);
}

// Positions in the plan's order must follow the plan that is pushed by.
Status Scene::State::check_plan_order(const Positions& positions) const {
  if (positions.by_rank.empty()) return {};
  const std::string hint = "ask Scene::plan() and put the positions into its order";
  if (positions.plan_version != plan_->version())
    return {Code::stale_plan,
            fmt::format("push to scene '{}': positions in the order of plan {}, it is {}", name_,
                        positions.plan_version, plan_->version()),
            hint};
  if (positions.by_rank.size() != static_cast<std::size_t>(plan_->ranks()))
    return {Code::invalid_argument,
            fmt::format("positions of {} ranks, there are {}", positions.by_rank.size(), plan_->ranks()), hint};
  for (std::size_t rank = 0; rank < positions.by_rank.size(); ++rank)
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims_); ++a)
      if (positions.by_rank[rank][a] == nullptr && !plan_->rows(static_cast<int>(rank)).empty())
        return {Code::invalid_argument, fmt::format("no array for axis {} of rank {}", kAxisNames[a], rank), hint};
  return {};
}

Result<StepResult> Scene::State::step(const Positions& positions, const StepOptions& options) {
  if (Status status = check(positions, options); !status) return status;
  if (!options.step && last_step_ && *last_step_ == std::numeric_limits<std::int64_t>::max())
    return Status(Code::invalid_argument, "there is no step number left");
  const std::int64_t step = options.step.value_or(last_step_ ? *last_step_ + 1 : 0);
  const Deadline deadline(with_margin(std::min(options.deadline_seconds, wire::kDeadlineSecondsMax)));
  bool plan_mended = false;
  bool connection_mended = false;
  bool data_mended = false;
  for (;;) {
    Status status = ready(positions.count, options.ids, deadline);
    if (status) {
      const auto answer = push(positions, options, step, deadline);
      if (answer) return finish(*answer, step, positions, options, deadline);
      status = answer.status();
    }
    const bool lost = status.code() == Code::unavailable && !session().connected();
    // A rank's connection went, and the push with it: once more, another way where the caller leaves the choice.
    if (status.code() == Code::aborted && session().data_lost() && !data_mended) {
      data_mended = true;
      continue;
    }
    if (status.code() == Code::stale_plan && !plan_mended) {
      plan_mended = true;
      plan_.reset();
      if (pushed_) continue;
      // Another client pushed first.
      if (Status opened = open(deadline.left_seconds()); !opened) return opened;
      if (Status fits = check(positions, options); !fits) return fits;
      continue;
    }
    if (!lost || connection_mended) return status;
    connection_mended = true;
  }
}

// The step is committed: whatever happens here, it stands.
Result<StepResult> Scene::State::finish(const Frame& answer, std::int64_t step, const Positions& positions,
                                        const StepOptions& options, const Deadline& deadline) {
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
    count_ = positions.count;
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
  Status current;
  if ((repeated && *repeated) || !epoch_follows || !step_follows || !apply(answer, *json, first, result.changes))
    current = fetch_plan(ids_by_row(options.ids), deadline);
  if (!current) {
    // Fetched again before the next push.
    plan_.reset();
    if (options.want_parts || options.want_changes)
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
  if (current) {
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
