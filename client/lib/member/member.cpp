// MemberScene: keeps the seat over lost connections and pushes a member's contribution to a step.
#include "client/lib/member.hpp"

#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include "client/lib/member/member_state.hpp"
#include "client/lib/scene/step_report.hpp"
#include "client/lib/session/content.hpp"
#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"

namespace rcb::client {

Status MemberScene::State::take_seat(const Retry& retry) {
  if (connection == session().generation()) return {};
  wire::Json request{
      {"scene", name}, {"member", options.member}, {"members", options.members}, {"follow", options.follow}};
  // The service may not have noticed yet that the previous connection was lost: a higher generation displaces it. Where
  // an answer was lost, the seat may have the generation that was asked for last.
  const std::uint64_t asked_before = asked;
  if (seat > 0) request["generation"] = asked = std::max(seat, asked) + 1;
  request["command"] = "scene.open";
  const auto json = described(session(), request, retry);
  // Busy: another process has taken the seat. Higher and higher numbers would take it from that one.
  if (json.status().code() == Code::busy) asked = asked_before;
  if (!json) return json.status();
  const auto found = json->find("membership");
  if (found == json->end()) return odd_member_answer("the service knows no members");
  const auto generation = wire::integer_field(*found, "generation", 1, kLarge);
  wire::FieldReader fields(*json);
  const auto axes = static_cast<int>(fields.integer("dims", 1, 3));
  const std::int64_t step = fields.integer_or("step", 0, wire::kStepMax, -1);
  const std::uint64_t count = fields.particles("n");
  const auto epoch_now = static_cast<std::uint64_t>(fields.integer_or("epoch", 0, kLarge, 0));
  const bool has_weights = fields.flag("weights");
  when_needed = fields.text_or("positions", 16, "every-step") == "when-needed";
  const std::string incarnation_now = fields.text_or("incarnation", 16, "");
  const bool filled_now = !fields.has("filled") || fields.flag("filled");
  fields.fail(generation.status());
  if (!fields.ok()) return odd_member_answer(fields.status().message());
  if (last_step && incarnation_now != incarnation) {
    static_cast<void>(session().call_once({{"command", "scene.close"}, {"scene", name}}, retry));
    return {Code::not_found, fmt::format("scene '{}' is another one than it was, made anew", name),
            "open it again, and push from its first step"};
  }
  connection = session().generation();
  const bool known_before = seat > 0;
  seat = static_cast<std::uint64_t>(*generation);
  dims = axes;
  const auto step_now = step >= 0 ? std::optional(step) : std::nullopt;
  incarnation = incarnation_now;
  filled = !step_now || filled_now;
  // A rebalance changes the epoch alone.
  if (known_before && (step_now != last_step || epoch_now != epoch || !filled)) {
    places.forget();
    up_to_date = false;
  }
  n = count;
  weights = has_weights;
  epoch = epoch_now;
  last_step = step_now;
  return {};
}

Status MemberScene::State::open() {
  Retry retry(options.deadline_seconds);
  const auto mend = [&](const Status& status) {
    // The service may not have noticed yet that the connection which holds the seat was lost: our previous one, or that
    // of a process in whose place this one was started.
    return session().outlive() && status.code() == Code::busy && session().wait(retry, status, status.message()).ok();
  };
  return session().retry_until_deadline(
      retry, [&] { return take_seat(retry); }, mend);
}

void MemberScene::State::forget_if_replaced() {
  const std::uint64_t now = client->run_of(name);
  if (std::exchange(run, now) == now) return;
  dims = client->known(name).dims.value_or(dims);
  n = epoch = 0;
  weights = up_to_date = false;
  last_step.reset();
  scene_cuts.known.reset();
  unanswered = {};
  places.forget();
}

Status MemberScene::State::check(const Positions& positions, std::span<const std::int64_t> ids,
                                 const MemberStepOptions& step) const {
  const auto wrong = [this](const std::string& message, const char* hint) { return wrong_push(name, message, hint); };
  if (Status status = check_arrays(name, positions, dims); !status) return status;
  if (ids.size() != positions.count)
    return wrong(fmt::format("{} ids for {} particles", ids.size(), positions.count), "give one id a particle");
  if (!step.weights.empty() && step.weights.size() != positions.count)
    return wrong(fmt::format("{} weights for {} particles", step.weights.size(), positions.count),
                 "give one weight a particle, or none");
  for (const std::uint64_t row : step.moved.value_or(std::span<const std::uint64_t>()))
    if (row >= positions.count)
      return wrong(fmt::format("row {} moved, there are {}", row, positions.count), "rows count from 0");
  if (step.inserted != nullptr)
    // A member that has brought no particles yet may not know of the scene's weights.
    if (Status status = check_insertion(name, *step.inserted, positions, dims,
                                        weights || !step.weights.empty() || !step.inserted->weights.empty());
        !status)
      return status;
  return check_terms(name, step.step, step.step_seconds, step.deadline_seconds, step.threads);
}

std::uint64_t MemberScene::State::content_of(const Positions& positions, std::span<const std::int64_t> ids,
                                             const MemberStepOptions& with) {
  Content content;
  content.add(std::uint64_t{with.unmoved ? 1U : 0U});
  content.add(positions);
  content.add(ids);
  content.add_options(with);
  return content.value();
}

Result<bool> MemberScene::State::needs_unanswered(const Retry& retry) {
  if (Status status = take_seat(retry); !status) return status;
  const auto json = described(session(), {{"command", "scene.show"}, {"scene", name}}, retry);
  if (!json) return json.status();
  wire::FieldReader fields(*json);
  const std::int64_t step = fields.integer_or("step", 0, wire::kStepMax, -1);
  const std::uint64_t count = fields.particles("n");
  const auto epoch_now = static_cast<std::uint64_t>(fields.integer_or("epoch", 0, kLarge, 0));
  if (!fields.ok()) return odd_member_answer(fields.status().message());
  if (step == unanswered.number() && unanswered.needed()) return true;
  const auto step_now = step >= 0 ? std::optional(step) : std::nullopt;
  if (step_now == last_step && step != unanswered.number()) return false;
  places.forget();
  scene_cuts.known.reset();
  up_to_date = false;
  last_step = step_now;
  n = count;
  epoch = epoch_now;
  return false;
}

MemberScene::MemberScene(std::unique_ptr<State> state) : state_(std::move(state)) {}
MemberScene::MemberScene(MemberScene&&) noexcept = default;
MemberScene& MemberScene::operator=(MemberScene&&) noexcept = default;
MemberScene::~MemberScene() = default;
Result<std::span<double>> MemberScene::position_rows(std::size_t count) {
  return state_->arrays.rows<double>(count, state_->dims_now());
}
Result<std::vector<std::span<double>>> MemberScene::position_axes(std::size_t count) {
  return state_->arrays.axes<double>(count, state_->dims_now());
}
Result<std::span<float>> MemberScene::position_rows_f4(std::size_t count) {
  return state_->arrays.rows<float>(count, state_->dims_now());
}
Result<std::vector<std::span<float>>> MemberScene::position_axes_f4(std::size_t count) {
  return state_->arrays.axes<float>(count, state_->dims_now());
}
std::optional<std::int64_t> MemberScene::last_step() const {
  state_->forget_if_replaced();
  return state_->last_step;
}
Result<cuts::Cuts> MemberScene::cuts(double deadline_seconds) {
  State& of = *state_;
  of.forget_if_replaced();
  return of.scene_cuts.current(of.epoch, of.session(), of.name, deadline_seconds,
                               [&of](const Retry& retry) { return of.take_seat(retry); });
}
std::uint64_t MemberScene::generation() const { return state_->seat; }

Result<MemberScene> MemberScene::open(Client& client, const std::string& name, const MemberOptions& options) {
  if (Status status = wire::check_scene_name(name); !status) return status;
  if (Status status = Client::State::refuse_both(client.state_->scenes, "Scene", name); !status) return status;
  auto state = std::make_unique<State>(client.state_, name, options);
  if (Status status = state->open(); !status) return status;
  return MemberScene(std::move(state));
}

Result<MemberStep> MemberScene::State::try_step(const Positions& positions, std::span<const std::int64_t> ids,
                                                std::int64_t step, const MemberStepOptions& with, const Retry& retry) {
  pushing_directly = pushing_few = false;
  if (Status status = take_seat(retry); !status) return status;
  const bool tried_before = unanswered.begin(step);
  auto counted = count(positions, ids, step, with, retry);
  const auto pushes = [&]() -> Result<Frame> {
    if (!filled && step == last_step) return ask_for_answer(step, with, retry);
    if (Status status = filled ? Status() : refill(positions, ids, with, retry); !status) return status;
    return push(positions, ids, step, with, retry);
  };
  const auto answer = !counted.ok()          ? Result<Frame>(counted.status())
                      : counted->has_value() ? Result<Frame>(std::move(**counted))
                                             : pushes();
  if (!answer) {
    unanswered.failed(answer.status().code(), tried_before);
    return answer.status();
  }
  auto result = read(*answer, positions, ids, step, with, retry);
  if (!result) {  // the step is committed, but its changes aren't known
    places.forget();
    up_to_date = false;
  }
  return result;
}

Result<MemberStep> MemberScene::step(const Positions& positions, std::span<const std::int64_t> ids,
                                     const MemberStepOptions& options) {
  state_->forget_if_replaced();
  if (Status status = state_->check(positions, ids, options); !status) return status;
  Retry retry(options.deadline_seconds);
  std::optional<std::int64_t> step = options.step;
  UnansweredStep& unanswered = state_->unanswered;
  const auto content = [&] { return State::content_of(positions, ids, options); };
  if (unanswered.is_pushed_again(step, content))
    step = unanswered.number();
  else if (unanswered)
    if (Status status =
            unanswered.settle(state_->session(), state_->name, retry, [&] { return state_->needs_unanswered(retry); });
        !status)
      return status;
  if (!step && state_->last_step && *state_->last_step == wire::kStepMax)
    return Status(Code::invalid_argument, "there is no step number left");
  if (!step) step = state_->last_step ? *state_->last_step + 1 : 0;
  const bool first = !state_->last_step;
  state_->send_all = false;
  state_->counting.begin_others();
  Session& session = state_->session();
  const auto once = [&] { return state_->try_step(positions, ids, *step, options, retry); };
  const auto mend = [&](const Status& status) {
    // The parts or the layout changed without this member knowing, or another member doesn't know them: push by ids.
    if (state_->pushing_directly && (status.code() == Code::stale_plan || status.code() == Code::base_lost)) {
      state_->places.forget();
      return true;
    }
    if (state_->pushing_few && !state_->send_all && status.code() == Code::base_lost) return state_->send_all = true;
    if (status.code() != Code::aborted) return false;
    // This member or another lost its connection. That one reconnects, and all members push again.
    const bool data_lost = session.data_lost();
    if (data_lost) state_->places.forget();
    state_->arrays.share_again();
    return (data_lost || session.outlive()) &&
           session.wait(retry, status, fmt::format("the members of scene '{}': {}", state_->name, status.message()))
               .ok();
  };
  auto result = session.retry_until_deadline(retry, once, mend);
  if (!result && unanswered)
    unanswered.keep(content(), first || options.inserted != nullptr || !options.removed.empty());
  return result;
}

}  // namespace rcb::client
