// Scene::step: check, push, and retry. Counts are in count_step.cpp; the answer is read in step_answer.cpp.
#include <algorithm>

#include <fmt/format.h>

#include "client/lib/scene/changes.hpp"
#include "client/lib/scene/scene.hpp"
#include "client/lib/scene/step_report.hpp"
#include "client/lib/session/content.hpp"
#include "client/lib/session/data_path.hpp"
#include "client/lib/session/push_source.hpp"
#include "common/wire/limits.hpp"

namespace rcb::client {
namespace {

wire::Json plan_json(const layout::Layout& plan) {
  return {{"version", plan.version()}, {"checksum", wire::hex64(plan.checksum())}};
}

}  // namespace

Status Scene::State::wrong(const std::string& message, std::string hint) const {
  return wrong_push(name_, message, std::move(hint));
}

Status Scene::State::check_positions(const StepRequest& ask) const {
  const Positions& positions = ask.positions;
  if (Status status = check_arrays(name_, positions, dims_); !status) return status;
  if (positions.count > static_cast<std::uint64_t>(wire::kParticlesMax))
    return wrong(fmt::format("{} particles", positions.count),
                 fmt::format("at most {} are taken", wire::kParticlesMax));
  if (pushed_ && ask.whole() && positions.count != count_)
    return wrong(fmt::format("{} particles, the scene has {}", positions.count, count_),
                 "push all particles of the scene, with those to insert or remove beside them, or create it anew with "
                 "replace");
  if (ask.moved == StepRequest::Moved::ids && positions.count != ask.ids.size())
    return wrong(fmt::format("{} positions of {} moved particles", positions.count, ask.ids.size()),
                 "give one position an id");
  return {};
}

Status Scene::State::check(const StepRequest& ask) const {
  const Positions& positions = ask.positions;
  const StepOptions& options = ask.options;
  if (Status status = check_positions(ask); !status) return status;
  if (ask.whole() && !options.ids.empty() && options.ids.size() != positions.count)
    return wrong(fmt::format("{} ids for {} particles", options.ids.size(), positions.count), "give one id a particle");
  if (!options.weights.empty() && ask.moved != StepRequest::Moved::all)
    return wrong("new weights in a push of few particles", "push all particles with their weights");
  if (!options.weights.empty() && options.weights.size() != positions.count)
    return wrong(fmt::format("{} weights for {} particles", options.weights.size(), positions.count),
                 "give one weight a particle, or none");
  if (pushed_ && !options.weights.empty() && !has_weights_)
    return wrong("weights, and the scene has none", "weights must be there from the first push on");
  if (!rows_assumed_ && (began_ || answered_ || !ids_.empty()) && ask.whole() && !options.ids.empty())
    for (std::size_t row = 0; row < options.ids.size(); ++row)
      if (const std::int64_t known = ids_.empty() ? static_cast<std::int64_t>(row) : ids_[row];
          options.ids[row] != known)
        return wrong(fmt::format("row {} has id {}, at first it had {}", row, options.ids[row], known),
                     "ids belong to rows, which insertions and removals alone change; leave them out after the first "
                     "push");
  const bool rows_unknown = ids_.empty() || rows_assumed_;
  if (pushed_ && has_ids_ && rows_unknown && options.ids.empty() && count_ > 0 && ask.whole())
    return wrong("the scene has ids of its own, and the push gives none",
                 "say whose positions these are: a column \"id\" in a file, StepOptions::ids in a program");
  if (Status status = check_terms(name_, options.step, options.step_seconds, options.deadline_seconds, options.threads);
      !status)
    return status;
  return check_edits(ask);
}

Status Scene::State::ready(std::uint64_t count, std::span<const std::int64_t> ids, const Retry& retry, bool with_plan) {
  if (!on_ranks()) {
    plan_.reset();
    if (with_plan) plan_ = layout::Layout::blocks(count, session().ranks(), ids);
    return {};
  }
  if (rows_assumed_ && !ids.empty()) {  // now the caller says it
    forget_rows();
    plan_.reset();
  }
  if (plan_ && plan_->ranks() != session().ranks()) plan_.reset();  // restarted with another number of ranks
  return plan_ || !with_plan ? Status{} : fetch_plan(ids_by_row(ids), retry);
}

std::span<const std::int64_t> Scene::State::ids_by_row(std::span<const std::int64_t> given) const {
  return ids_.empty() ? given : std::span<const std::int64_t>(ids_);
}

Result<Frame> Scene::State::push(const StepRequest& ask, std::int64_t step, std::optional<std::int64_t> base,
                                 const Retry& retry) {
  const Positions& positions = ask.positions;
  const StepOptions& options = ask.options;
  const bool all = ask.moved == StepRequest::Moved::all;
  const bool send_ids = !on_ranks() && !options.ids.empty();
  Selection few;
  if (ask.moved == StepRequest::Moved::rows || ask.moved == StepRequest::Moved::ids) {
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
                   {"weights", !options.weights.empty() || (pushed_ && !filled_ && has_weights_)},
                   {"ids", send_ids},
                   {"changes", plan_.has_value()},
                   {"inserted", ask.inserted()},
                   {"removed", options.removed.size()},
                   {"inserted_ids", ask.inserted() > 0 && !options.inserted->ids.empty()},
                   {"deadline_seconds", retry.seconds_left()}};
  if (options.step_seconds) begin["step_seconds"] = *options.step_seconds;
  if (pushed_ && !filled_) begin["refill"] = true;
  if (on_ranks() && counted_.drifted()) begin["drifted"] = *counted_.drifted();
  if (uses_cuts(ask)) begin["cuts_known"] = cuts_.known_json();
  const std::string what = fmt::format("push of step {} to scene '{}'", step, name_);
  if (shared_) return push_shared(std::move(begin), ask, what, retry.deadline());
  std::vector<const void*> slots;  // by rank
  std::vector<Column> columns = columns_of(positions, options.weights);
  if (send_ids) columns.push_back({"id", "<i8", options.ids.data(), 1});
  RankRows rows;
  if (all) {
    rows = all_rows(*plan_);
  } else if (some) {
    begin["counts"] = wire::Json::array();
    for (std::size_t rank = 0; rank < few.slots.size(); ++rank) {
      begin["counts"].push_back(few.slots[rank].size());
      rows.emplace_back(few.places[rank]);
      slots.push_back(few.slots[rank].data());
    }
    columns.push_back({"slot", "<u8", nullptr, 1, slots.data()});
  }
  return send(std::move(begin), rows, std::move(columns), ask, what, retry.deadline());
}

bool Scene::State::by_shared_memory(const StepRequest& ask, const Retry& retry) {
  const Path path = session().path();
  if ((path != Path::automatic && path != Path::shared) || ask.moved != StepRequest::Moved::all ||
      ask.positions.count == 0 || shared_unsupported_)
    return false;
  // The ranks on other hosts get slices, by a layout, which a first push hasn't. It is worth while if few positions are
  // copied for nothing.
  const auto worth_while = [&] {
    const std::size_t apart = session().ranks_apart().size();
    const bool large = ask.positions.count * static_cast<std::size_t>(dims_) * sizeof(double) >= kDirectBytesMin;
    const bool few_copies = arrays_.gave(ask.positions) || 2 * apart <= static_cast<std::size_t>(session().ranks());
    return apart == 0 || (on_ranks() && (path == Path::shared || (large && few_copies)));
  };
  // Where the connections to the ranks are opened it may turn out that more of them are apart.
  return worth_while() && session().can_share(retry.deadline()) && worth_while();
}

bool Scene::State::rows_are_ids(const StepRequest& ask) const {
  if (!on_ranks()) return true;
  if (has_ids_) return false;
  std::int64_t row = 0;
  const auto ids = ids_by_row(ask.options.ids);
  return std::all_of(ids.begin(), ids.end(), [&row](std::int64_t id) { return id == row++; });
}

Result<Frame> Scene::State::push_shared(wire::Json begin, const StepRequest& ask, const std::string& what,
                                        const Deadline& deadline) {
  SharedArrays::Values values{.positions = ask.positions, .weights = ask.options.weights};
  if (!on_ranks()) values.ids = ask.options.ids;
  RankRows rows;
  if (!by_id_) {
    rows = all_rows(*plan_);
    values.rows = rows;
    values.layout = {plan_->number(), plan_->version()};
    for (const auto& of_rank : rows) begin["counts"].push_back(of_rank.size());
  }
  auto memory = arrays_.describe(session(), values, deadline);
  if (!memory) return memory.status();
  const std::uint64_t request = session().next_request();
  const EditFrames edits = edit_frames(begin, request, ask.options.removed, ask.options.inserted);
  begin["command"] = "push.begin";
  begin["path"] = "shared";
  begin["order"] = by_id_ ? "id" : "plan";
  begin["memory"] = std::move(*memory);
  begin["slices"] = edits.count;
  return session().exchange_shared(request, std::move(begin), edits.bytes, std::move(rows),
                                   columns_of(ask.positions, ask.options.weights), what, deadline);
}

Result<Frame> Scene::State::send(wire::Json begin, const RankRows& rows, std::vector<Column> columns,
                                 const StepRequest& ask, const std::string& what, const Deadline& deadline) {
  const std::uint64_t request = session().next_request();
  const EditFrames edits = edit_frames(begin, request, ask.options.removed, ask.options.inserted);
  std::size_t particles = 0;
  for (const auto& of_rank : rows) particles += of_rank.size();
  const bool large = particles * particle_bytes(columns) >= kDirectBytesMin;
  const Path path = session().path();
  if (particles > 0 && (path == Path::direct || (path != Path::gateway && large))) {
    if (session().data(deadline) != nullptr) {
      const wire::Json slice = slice_json(begin);
      begin["command"] = "push.begin";
      begin["path"] = "direct";
      begin["slices"] = edits.count;
      return session().exchange_directly(request, request_frame(request, begin) + edits.bytes, slice, rows, columns,
                                         what, deadline);
    }
    if (path == Path::direct) return session().no_data();
  }
  PushSource source(begin, request, rows, std::move(columns), edits.bytes, edits.count);
  return session().exchange(request, source, what, deadline);
}

Result<StepResult> Scene::State::step(StepRequest ask) {
  forget_if_replaced();
  // If the scene has no particles, those pushed are sent as insertions.
  Insertion all;
  if (pushed_ && count_ == 0 && ask.whole() && ask.positions.count > 0 && !ask.edits()) {
    all = {ask.positions, ask.options.ids, ask.options.weights};
    ask.positions = Positions{.dims = all.positions.dims};
    ask.options.ids = {};
    ask.options.weights = {};
    ask.options.inserted = &all;
    ask.moved = StepRequest::Moved::all;
  }
  const StepOptions& options = ask.options;
  Retry retry(options.deadline_seconds);
  // Another client may have made it anew, with other dimensions.
  if (replaced_ && options.deadline_seconds > 0)
    if (Status status = open(retry); !status) return status;
  Status fits = check(ask);
  const bool again = fits && unanswered_.is_pushed_again(options.step, [&] { return content_of(ask); });
  if (unanswered_ && !again) {  // before it is said what doesn't fit: that may be a scene which is not known yet
    if (Status status = unanswered_.settle(session(), name_, retry, [&] { return needs_unanswered(retry); }); !status)
      return status;
    fits = check(ask);
  }
  if (!fits) return fits;
  if (!again && !options.step && last_step_ && *last_step_ == wire::kStepMax)
    return Status(Code::invalid_argument, "there is no step number left");
  if (!pushed_ && !ask.whole())
    return Status(Code::base_lost, fmt::format("push to scene '{}': it has no positions yet", name_),
                  "push all positions with step()");
  if (!again && options.step && last_step_ && *options.step <= *last_step_)
    return Status(Code::stale_step,
                  fmt::format("step {} of scene '{}' is not above the last one, {}", *options.step, name_, *last_step_),
                  "to go back to an earlier state, push it as a later step, or create the scene again");
  const std::int64_t step = again ? *unanswered_.number() : options.step.value_or(last_step_ ? *last_step_ + 1 : 0);
  const StepRequest original = ask;
  const std::optional<std::int64_t> base = last_step_;
  // Which positions the others had before, only a Scene knows that has heard of a step.
  if (!base || (!answered_ && ask.moved == StepRequest::Moved::rows)) ask.moved = StepRequest::Moved::all;
  count_if_committed_ = count_ + ask.inserted() - options.removed.size();
  if (!again && (ask.moved != StepRequest::Moved::none || ask.edits())) counted_.begin();
  first_ = !pushed_ || (again && first_);
  auto result = push_and_complete(ask, step, base, retry);
  if (!result && unanswered_) unanswered_.keep(content_of(original), first_ || ask.edits());
  return result;
}

Result<StepResult> Scene::State::push_and_complete(StepRequest& ask, std::int64_t step,
                                                   std::optional<std::int64_t> base, Retry& retry) {
  std::uint64_t plan_fetched_on = 0;  // generation of the connection
  const auto once = [&] { return try_step(ask, step, base, retry); };
  const auto mend = [&](const Status& status) {
    switch (status.code()) {
      case Code::aborted: {
        // A rank's connection was lost, and the push with it: retry on another path, if the caller leaves the choice.
        const bool data_lost = session().data_lost();
        arrays_.share_again();
        return (data_lost || session().outlive()) &&
               session().wait(retry, status, fmt::format("scene '{}': {}", name_, status.message())).ok();
      }
      case Code::base_lost:
        if (ask.moved != StepRequest::Moved::rows) return false;
        ask.moved = StepRequest::Moved::all;
        return true;
      case Code::stale_plan:
        if (std::exchange(plan_fetched_on, session().generation()) == session().generation()) return false;
        plan_.reset();
        if (!pushed_) generation_ = 0;  // another client made the first push
        return true;
      case Code::unsupported:
      case Code::too_large:
      case Code::io_error:
        if (!shared_ || shared_unsupported_) return false;
        shared_unsupported_ = true;  // by another way, then
        return true;
      default:
        return false;
    }
  };
  auto done = session().retry_until_deadline(retry, once, mend);
  return done ? complete(ask, std::move(*done), retry) : done.status();
}

std::uint64_t Scene::State::content_of(const StepRequest& ask) const {
  Content content;
  content.add(static_cast<std::uint64_t>(ask.moved));
  content.add(ask.positions);
  content.add(ask.ids);
  content.add(ask.options.ids);
  content.add_options(ask.options);
  return content.value();
}

Result<bool> Scene::State::needs_unanswered(const Retry& retry) {
  if (Status status = hold(retry); !status) return status;
  // The ranks answer this after whatever of the step was still under way.
  const auto step = step_in_force(retry);
  if (!step) return step.status();
  if (*step == unanswered_.number() && unanswered_.needed()) return true;
  // The caller pushes something else, so it may build on the step before.
  if (*step == unanswered_.number() || *step != last_step_) missed_ = base_unknown_ = true;
  last_step_ = *step;
  return false;
}

Result<std::optional<std::int64_t>> Scene::State::step_in_force(const Retry& retry) {
  const auto json = described(session(), {{"command", "scene.show"}, {"scene", name_}}, retry);
  if (!json) return json.status();
  const auto found = read_description(*json);
  if (!found) return found.status();
  return found->step;
}

Result<Scene::State::Committed> Scene::State::try_step(const StepRequest& ask, std::int64_t step,
                                                       std::optional<std::int64_t> base, const Retry& retry) {
  const bool was_held = held();
  if (Status status = hold(retry); !status) return status;
  if (!was_held)
    if (Status fits = check(ask); !fits) return fits;
  if (base_unknown_ && ask.moved != StepRequest::Moved::all)
    return Status(
        Code::base_lost,
        fmt::format("the positions of step {} of scene '{}' may be others than those that this step builds on",
                    last_step_.value_or(0), name_),
        "push all positions with step()");
  StepRequest sent = ask;
  const bool tried_before = unanswered_.begin(step);
  auto counted = step_by_count(sent, step, retry);
  const bool by_count = counted.ok() && counted->has_value();
  const auto frame = !counted.ok() ? Result<Frame>(counted.status())
                     : by_count    ? Result<Frame>(std::move(**counted))
                                   : step_by_push(sent, step, base, retry);
  if (!frame) {
    unanswered_.failed(frame.status().code(), tried_before);
    if (frame.status().code() == Code::stale_step) {  // another session has pushed that number: go on behind it
      if (const auto others = step_in_force(retry); others.ok()) last_step_ = *others;
      missed_ = base_unknown_ = true;
    }
    return frame.status();
  }
  auto answer = read_answer(*frame, step, tried_before);
  // This comes before anything here changes: until then the step can be pushed once more.
  if (const Status told = answer ? complete_answer(*frame, sent, retry, *answer) : Status(); !told)
    return parts_unknown(step, told);
  unanswered_.answered();
  if (!answer) return answer.status();
  return finish(*frame, std::move(*answer), sent);
}

Result<Frame> Scene::State::step_by_push(StepRequest& ask, std::int64_t step, std::optional<std::int64_t> base,
                                         const Retry& retry) {
  if (pushed_ && !filled_) {
    if (step == last_step_) return ask_for_answer(ask, step, retry);
    if (Status status = refill(ask, retry); !status) return status;
  }
  if ((when_needed_ || older_) && pushed_ && ask.whole()) {  // those that the ranks hold may be older
    ask.moved = StepRequest::Moved::all;
    if (has_weights_ && ask.options.weights.empty() && weights_.size() == count_) ask.options.weights = weights_;
  }
  // From shared memory the ranks take the particles by id, where rows are ids. Then the layout is of use only to tell
  // which parts changed.
  shared_ = by_shared_memory(ask, retry);
  by_id_ = shared_ && session().ranks_apart().empty() && rows_are_ids(ask);
  const bool asks_plan = ask.wants() && !ask.wants_by_cuts();
  const bool with_plan = (!by_id_ && ask.moved != StepRequest::Moved::none) || asks_plan || ask.edits();
  if (shared_ && !with_plan) plan_.reset();
  const std::uint64_t count = pushed_ ? count_ : ask.positions.count;
  if (Status status = ready(count, ask.options.ids, retry, with_plan); !status) return status;
  return push(ask, step, base, retry);
}

}  // namespace rcb::client
