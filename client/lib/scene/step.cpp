// Scene::step: check, count or push, retry, and what the answer says.
#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "client/lib/scene/scene.hpp"
#include "client/lib/scene/step_report.hpp"
#include "client/lib/session/content.hpp"
#include "common/base/axis_names.hpp"
#include "common/cuts/halo.hpp"
#include "common/cuts/id_sum.hpp"
#include "common/layout/layout.hpp"
#include "common/wire/limits.hpp"

namespace rcb::client {
namespace {

std::vector<PartChange> differences(std::span<const std::int32_t> before, std::span<const std::int32_t> now) {
  std::vector<PartChange> changes;
  for (std::size_t row = 0; row < now.size(); ++row)
    if (before.empty() || before[row] != now[row]) changes.push_back({row, now[row]});
  return changes;
}

std::vector<LeavingRow> leaving_rows(std::span<const std::int32_t> part, int parts, const SeatOptions& seat) {
  constexpr std::size_t kTogether = 64;  // few leave, so rows are looked at together
  const layout::PartRange own = layout::parts_of_rank(seat.seat, parts, seat.seats);
  const auto leaves = [own](std::int32_t p) { return p < own.begin || p >= own.end; };
  std::vector<LeavingRow> leaving;
  for (std::size_t first = 0; first < part.size(); first += kTogether) {
    const auto rows = part.subspan(first, std::min(kTogether, part.size() - first));
    int some = 0;
    for (const std::int32_t p : rows) some |= leaves(p);
    for (std::size_t i = 0; some != 0 && i < rows.size(); ++i)
      if (leaves(rows[i])) leaving.push_back({first + i, cuts::seat_of_part(rows[i], parts, seat.seats)});
  }
  return leaving;
}

}  // namespace

Status Scene::State::wrong(const std::string& message, std::string hint) const {
  return {Code::invalid_argument, fmt::format("push to scene '{}': {}", name_, message), std::move(hint)};
}

Status Scene::State::check(const StepRequest& ask) const {
  const Positions& positions = ask.positions;
  const StepOptions& options = ask.options;
  if (positions.dims != dims_)
    return wrong(fmt::format("positions of {} dimensions, the scene has {}", positions.dims, dims_),
                 fmt::format("make the scene with dims {}, in place of this one (replace)", positions.dims));
  for (std::size_t a = 0; positions.count > 0 && a < static_cast<std::size_t>(dims_); ++a)
    if (positions.single() ? positions.axis_f4[a] == nullptr : positions.axis[a] == nullptr)
      return wrong(fmt::format("no array for axis {}", kAxisNames[a]), "give one array an axis");
  if (positions.stride == 0) return wrong("a stride of 0", "a stride is at least 1");
  if (positions.count > static_cast<std::uint64_t>(wire::kParticlesMax))
    return wrong(fmt::format("{} particles", positions.count),
                 fmt::format("at most {} are taken", wire::kParticlesMax));
  if (options.ids.size() != positions.count && (!options.ids.empty() || seated()))
    return wrong(fmt::format("{} ids for {} particles", options.ids.size(), positions.count),
                 seated() ? "give one id a particle: seats can't tell by their rows whose they are"
                          : "give one id a particle, or none");
  if (!options.weights.empty() && options.weights.size() != positions.count)
    return wrong(fmt::format("{} weights for {} particles", options.weights.size(), positions.count),
                 "give one weight a particle, or none");
  if (options.step && *options.step < 0) return wrong(fmt::format("step {}", *options.step), "steps count from 0");
  if (options.step_seconds && !(*options.step_seconds >= 0 && std::isfinite(*options.step_seconds)))
    return wrong(fmt::format("a step of {} seconds", *options.step_seconds), "give a finite number >= 0, or none");
  if (options.threads < 1) return wrong(fmt::format("{} threads", options.threads), "give 1 or more");
  if (!(options.deadline_seconds > 0))
    return wrong(fmt::format("a deadline of {} seconds", options.deadline_seconds), "give a number above 0");
  return {};
}

std::uint64_t Scene::State::content_of(const StepRequest& ask) {
  Content content;
  content.add(ask.positions);
  content.add(ask.options.ids);
  content.add(ask.options.weights);
  content.add(ask.options.inserted);
  content.add(ask.options.removed);
  return content.value();
}

std::span<const double> Scene::State::weights_of(const StepRequest& ask) const {
  const bool kept = has_weights_ && ask.options.weights.empty() && weights_rows_ == ask.rows;
  return kept ? std::span<const double>(weights_) : ask.options.weights;
}

CountedRows Scene::State::rows_of(const StepRequest& ask) const {
  return {ask.positions,   ask.options.ids, ask.rows.ids,
          weights_of(ask), has_weights_,    std::max(ask.options.threads, threads_)};
}

Result<StepResult> Scene::State::step(const Positions& positions, const StepOptions& options) {
  Retry retry(options.deadline_seconds);
  const StepRequest ask{positions, options, {positions.count, cuts::sum_ids(options.ids, 0)}};
  if (Status fits = check(ask); !fits) return fits;
  const auto content = [&ask] { return content_of(ask); };
  const bool again = unanswered_.is_pushed_again(options.step, content);
  if (unanswered_ && !again)
    if (Status status = unanswered_.settle(session(), name_, retry, [&] { return needs_unanswered(retry); }); !status)
      return status;
  if (!again && !options.step && last_step_ && *last_step_ == wire::kStepMax)
    return Status(Code::invalid_argument, "there is no step number left");
  if (!again && options.step && last_step_ && *options.step <= *last_step_)
    return Status(Code::stale_step,
                  fmt::format("step {} of scene '{}' is not above the last one, {}", *options.step, name_, *last_step_),
                  "to go back to an earlier state, push it as a later step, or create the scene again");
  const std::int64_t step = again ? *unanswered_.number() : options.step.value_or(last_step_ ? *last_step_ + 1 : 0);
  const bool needed = !last_step_ || ask.flows();
  if (!again) counted_.begin(ask.rows != rows_);
  rows_ = ask.rows;
  auto result = step_until_deadline(ask, step, retry);
  if (!result && unanswered_) unanswered_.keep(content(), needed);
  return result;
}

Result<StepResult> Scene::State::step_until_deadline(const StepRequest& ask, std::int64_t step, Retry& retry) {
  const auto once = [&] { return try_step(ask, step, retry); };
  const auto mend = [&](const Status& status) {
    switch (status.code()) {
      case Code::aborted:  // a rank's connection was lost, or another seat's: all push again
        arrays_.share_again();
        return session().wait(retry, status, fmt::format("scene '{}': {}", name_, status.message())).ok();
      case Code::unsupported:
      case Code::too_large:
      case Code::io_error:
        // By another way, then.
        return (way_ == Way::shared || way_ == Way::held) && session().stop_sharing();
      default:
        return false;
    }
  };
  return session().retry_until_deadline(retry, once, mend);
}

Result<bool> Scene::State::needs_unanswered(const Retry& retry) {
  if (Status status = hold(retry); !status) return status;
  // This is answered after whatever of the step was still under way.
  const auto step = step_in_force(retry);
  if (!step) return step.status();
  if (*step == unanswered_.number() && unanswered_.needed()) return true;
  last_step_ = *step;
  return false;
}

bool Scene::State::can_count(const StepRequest& ask) const {
  if (!when_needed_ || !last_step_ || ask.options.send) return false;
  const bool ids_fit = !(has_ids_ || ask.flows()) || !ask.options.ids.empty();
  const bool weights_fit = weights_of(ask).empty() != has_weights_;
  return ask.positions.count == 0 || (ids_fit && weights_fit);
}

Result<std::optional<Answer>> Scene::State::step_by_count(const StepRequest& ask, std::int64_t step,
                                                          const Retry& retry) {
  if (!can_count(ask)) return std::optional<Answer>();
  return counted_.ask({session(), name_, incarnation_, step, last_step_, ask.options, seated()}, rows_of(ask), cuts_,
                      retry);
}

Result<StepResult> Scene::State::try_step(const StepRequest& ask, std::int64_t step, const Retry& retry) {
  way_ = Way::endpoint;
  if (Status status = hold(retry); !status) return status;
  const bool tried_before = unanswered_.begin(step);
  auto answer = step_by_count(ask, step, retry);
  if (answer && !*answer) {
    auto frame = push(ask, step, retry);
    if (frame)
      answer->emplace(std::move(*frame));
    else
      answer = frame.status();
  }
  if (!answer) {
    unanswered_.failed(answer.status().code(), tried_before);
    if (answer.status().code() == Code::stale_step)  // another session has pushed that number: go on behind it
      if (const auto others = step_in_force(retry); others.ok()) last_step_ = *others;
    return answer.status();
  }
  return take_answer(**answer, ask, step, tried_before, retry);
}

Result<std::optional<cuts::Cuts>> Scene::State::complete(const Frame& frame, const wire::Json& json,
                                                         const StepReport& report, const StepRequest& ask,
                                                         const Retry& retry) {
  auto after = cuts_.after_step(frame, json, report.epoch);
  const bool needed = ask.wants() || seated() || when_needed_;
  // Else the next step, which sorts its rows by part, could not tell how many have drifted.
  const bool useful = way_ != Way::held && after && after->has_value();
  if (!after || !(needed || useful)) return after;
  if (!after->has_value()) {
    auto asked = SceneCuts::ask(session(), name_, retry);
    if (!asked) return asked.status();
    after->emplace(std::move(*asked));
  }
  if (Status found = counted_.find_parts(**after, rows_of(ask), last_step_); !found) return found;
  return after;
}

Result<StepReport> Scene::State::report_of(const Result<wire::Json>& json, std::int64_t step, bool tried_before) const {
  if (!json) return json.status();
  const auto found = json->find("report");
  if (found == json->end()) return Status(Code::protocol_error, "answer to a push: no 'report'");
  if (tried_before || seated() || !wire::is_true(*json, "repeated")) return read_report(*found);
  return Status(Code::stale_step,
                fmt::format("step {} of scene '{}' was pushed by another Scene of this client", step, name_),
                "use one Scene for each scene of a client");
}

Result<StepResult> Scene::State::take_answer(const Answer& answer, const StepRequest& ask, std::int64_t step,
                                             bool tried_before, const Retry& retry) {
  const auto& json = answer.json;
  auto report = report_of(json, step, tried_before);
  if (!report) {
    unanswered_.answered();
    return report.status();
  }
  // This comes before anything here changes: until then the step can be pushed once more.
  auto after = complete(answer.frame, *json, *report, ask, retry);
  if (!after)
    return Status(after.status().code(),
                  fmt::format("step {} is committed, but its parts are not known: {}", step, after.status().message()),
                  after.status().hint());
  unanswered_.answered();
  const StepOptions& options = ask.options;
  if (!last_step_ || ask.flows())
    has_ids_ = std::ranges::any_of(options.ids, [&](auto id) { return static_cast<std::uint64_t>(id) >= report->n; });
  has_weights_ = has_weights_ || !options.weights.empty();
  if (!options.weights.empty() && options.weights.data() != weights_.data()) {
    weights_.assign(options.weights.begin(), options.weights.end());
    weights_rows_ = ask.rows;
  }
  last_step_ = std::max(report->step, last_step_.value_or(report->step));
  epoch_ = report->epoch;
  filled_ = filled_ || (report->sent && !wire::is_true(*json, "repeated"));
  cuts_.known = std::move(*after);
  counted_.committed(report->step);
  StepResult result{std::move(*report), {}, {}, {}};
  tell_parts(ask, result);
  return result;
}

void Scene::State::tell_parts(const StepRequest& ask, StepResult& result) {
  const auto parts = counted_.parts();
  if (seated()) result.leaving = leaving_rows(parts, cuts_.known->parts(), seat_);
  if (!ask.wants()) return;
  if (ask.options.want_changes)
    result.changes = differences(told_rows_ == ask.rows ? told_ : std::span<const std::int32_t>(), parts);
  told_.assign(parts.begin(), parts.end());
  told_rows_ = ask.rows;
  if (ask.options.want_parts) result.parts = told_;
}

}  // namespace rcb::client
