// SeatGroups, part 2: a step of all seats, from the first push.begin to the last answer.
#include <algorithm>
#include <utility>

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include "common/wire/limits.hpp"
#include "server/api/ledger_answers.hpp"
#include "server/net/control/push_order.hpp"
#include "server/net/control/seats.hpp"

namespace rcb::net {

using wire::FrameType;

namespace {

// To all that have begun.
void tell_pushing(const std::vector<std::shared_ptr<OpenPush>>& contributions, FrameType type, const wire::Json& json) {
  const std::string text = wire::dump_json(json);
  for (const auto& one : contributions)
    if (one) one->connection->send_text(type, one->request, text);
}

}  // namespace

Status SeatGroups::begin(ContributionBegin begin) {
  const std::string& scene = begin.id.scene;
  Group* group = find(scene);
  // While this push.begin waited for its turn, another generation may have taken the seat, or the scene was dropped.
  const auto taken = group == nullptr ? std::nullopt : seat_of(*group, begin.connection.get());
  if (!taken)
    return {Code::aborted, fmt::format("another generation of this seat has opened scene '{}'", scene),
            "open the scene again with a higher generation"};
  const std::size_t seat = *taken;
  const scene::Ledger* ledger = coordinator_.scenes().find(scene);
  if (ledger == nullptr) return coordinator_.unknown_scene(scene);
  if (ledger->was_in_last(begin.id.session, begin.id.step)) {
    if (may_bring_slices(begin.json)) coordinator_.refuse_directly(begin.id);
    begin.connection->send_text(FrameType::reply, begin.request, api::repeated_to_seat(*ledger));
    return {};
  }
  const ControlOptions& options = coordinator_.options();
  auto terms =
      read_push_terms(begin.json, begin.id, ledger->now(), options.ranks, options.bulk_bytes_max, group->seats.size());
  if (!terms.ok()) return terms.status();
  const auto open = coordinator_.gate(scene).push;
  std::shared_ptr<SeatPush> step = open ? open->round : nullptr;
  if (step && step->step != begin.id.step)
    return {Code::invalid_argument,
            fmt::format("seat {} pushes step {}, the others push step {}", seat, begin.id.step, step->step),
            "all seats push the same step"};
  const auto older = step ? step->contributions[seat] : nullptr;
  if (older) {
    const PushId& id = older->slices.terms().id;
    if (id.session != begin.id.session || id.attempt >= begin.id.attempt)
      return {Code::busy, fmt::format("seat {} is pushing step {} already", seat, step->step), "finish it first"};
    withdraw(*older);
  }
  if (!step) step = open_step(scene, begin.id.step, *group);
  answer_count(*group, wire::dump_json({{"send", fmt::format("{} pushes this step", name(scene, seat))}}));
  auto contribution = std::make_shared<OpenPush>(coordinator_.context(), std::move(*terms));
  contribution->connection = std::move(begin.connection);
  contribution->client = std::move(begin.client);
  contribution->request = begin.request;
  contribution->begin = std::move(begin.json);
  contribution->held = std::move(begin.held);
  contribution->round = step;
  contribution->seat = static_cast<int>(seat);
  contribution->end = begin.end;
  step->contributions[seat] = contribution;
  if (!older) ++step->begun;
  step->ready = std::min(step->ready, seat);
  TimePoint end = std::min(step->end, begin.end);
  if (older) {  // its end counts no more
    end = TimePoint::max();
    for (const auto& one : step->contributions)
      if (one) end = std::min(end, one->end);
  }
  if (std::exchange(step->end, end) != end) coordinator_.arm(step->front.lock(), end);
  if (contribution->slices.terms().direct()) coordinator_.receive_directly(contribution);
  if (Status fits = check_together(*step); !fits.ok()) abort(step, nullptr, fits);
  if (contribution->given_up) return {};
  if (contribution->ready())
    contribution_whole(contribution);
  else
    coordinator_.arm(contribution, begin.end);
  return {};
}

void SeatGroups::withdraw(OpenPush& contribution) {
  contribution.given_up = true;
  coordinator_.give_back(contribution);
  const PushTerms& terms = contribution.slices.terms();
  if (terms.direct()) coordinator_.refuse_directly(terms.id);
  contribution.connection->send(FrameType::failure, contribution.request,
                                wire::failure_json({Code::aborted, "a newer attempt of the same session replaced it"}));
}

Status SeatGroups::check_together(const SeatPush& step) const {
  if (step.begun < step.contributions.size()) return {};
  std::uint64_t n = 0, inserted = 0, removed = 0, bytes = 0;
  const OpenPush* with_rows = nullptr;
  for (const auto& contribution : step.contributions) {
    const PushTerms& terms = contribution->slices.terms();
    n += terms.n;
    inserted += terms.inserted;
    removed += terms.removed;
    bytes += terms.bytes();
    if (terms.n == 0) continue;
    if (with_rows != nullptr && with_rows->slices.terms().weights != terms.weights)
      return {
          Code::invalid_argument,
          fmt::format("{} and {} don't both push weights", name(step.scene, static_cast<std::size_t>(with_rows->seat)),
                      name(step.scene, static_cast<std::size_t>(contribution->seat))),
          "all seats push weights, or none does"};
    with_rows = contribution.get();
  }
  if (const std::uint64_t most = coordinator_.options().bulk_bytes_max; bytes > most)
    return {Code::too_large, fmt::format("the seats push {} bytes together, at most {} are taken", bytes, most),
            "start the service with a larger --bulk-bytes, or on a larger machine"};
  const scene::SceneState& scene = coordinator_.scenes().find(step.scene)->now();
  return scene.step ? scene::check_conserved(step.scene, scene.n, n, inserted, removed) : Status();
}

std::shared_ptr<SeatPush> SeatGroups::open_step(const std::string& scene, std::int64_t step, const Group& group) {
  PushTerms none;
  none.id.scene = scene;
  none.id.step = step;
  const auto front =
      coordinator_.open_push(std::move(none), nullptr, "the seats of the scene", wire::kDeadlineSecondsMax);
  auto round = std::make_shared<SeatPush>(coordinator_.context(), scene, step);
  round->contributions.resize(group.seats.size());
  round->front = front;
  front->round = round;
  asio::co_spawn(coordinator_.context(), watch(coordinator_.shared_from_this(), round), asio::detached);
  return round;
}

void SeatGroups::contribution_whole(const std::shared_ptr<OpenPush>& contribution) {
  const auto step = contribution->round;
  if (step->all_ready()) order(step);
}

void SeatGroups::order(const std::shared_ptr<SeatPush>& step) {
  auto [request, options] =
      order_of(step->contributions, step->contributions.size(), *coordinator_.scenes().find(step->scene));
  options.received_seconds = seconds_since(step->started);
  options.deadline_seconds = std::chrono::duration<double>(step->end - step->started).count();
  request["deadline_seconds"] = options.deadline_seconds;
  const std::shared_ptr<Coordinator> coordinator = coordinator_.shared_from_this();
  options.then = [coordinator, step](Answer answer) { coordinator->groups().answered(step, std::move(answer)); };
  coordinator_.close_push(step->front.lock());
  step->ordered = true;
  const auto pending = coordinator_.order(std::move(request), std::move(options));
  coordinator_.erase_gate_if_unused(step->scene);
  if (pending.ok()) return;
  for (const auto& contribution : step->contributions)
    if (contribution->number != 0) coordinator_.refuse_directly(contribution->slices.terms().id);
  answered(step, api::failed(pending.status()));
}

void SeatGroups::answered(const std::shared_ptr<SeatPush>& step, Answer answer) {
  const auto contributions = std::exchange(step->contributions, {});
  const bool told = std::exchange(step->over, true);
  step->timer.cancel();
  if (!answer.status.ok())
    spdlog::info("step {} of scene '{}' by {} seats: {}: {}", step->step, step->scene, contributions.size(),
                 code_name(answer.status.code()), answer.status.message());
  if (told) return;
  if (!answer.status.ok()) return tell_pushing(contributions, FrameType::failure, wire::failure_json(answer.status));
  const auto arrays = std::make_shared<const std::vector<wire::Array>>(std::move(answer.arrays));
  if (!arrays->empty()) answer.json["arrays"] = wire::describe(*arrays);
  const std::string with_cuts = wire::dump_json(answer.json);  // for who has said which it knows
  answer.json.erase("cuts");
  answer.json.erase("arrays");
  const std::string text = wire::dump_json(answer.json);
  for (const auto& one : contributions)
    if (one->slices.terms().cuts_known)
      one->connection->send_text(FrameType::reply, one->request, with_cuts, arrays);
    else
      one->connection->send_text(FrameType::reply, one->request, text);
}

void SeatGroups::abort(const std::shared_ptr<SeatPush>& step, const OpenPush* contribution, const Status& why) {
  if (step->ordered || step->over) return;
  const auto front = step->front.lock();
  const std::string who =
      contribution != nullptr ? name(step->scene, static_cast<std::size_t>(contribution->seat)) + ": " : "";
  const Status named(why.code(), who + why.message(), why.hint());
  spdlog::info("step {} of scene '{}' by {} seats given up: {}", step->step, step->scene, step->contributions.size(),
               named.message());
  step->over = true;
  step->timer.cancel();
  front->given_up = true;
  coordinator_.close_push(front);
  const auto contributions = std::exchange(step->contributions, {});
  for (const auto& one : contributions) {
    if (!one) continue;
    one->given_up = true;
    if (one->number != 0) coordinator_.refuse_directly(one->slices.terms().id);
    coordinator_.give_back(*one);
  }
  tell_pushing(contributions, FrameType::failure, wire::failure_json(named));
  coordinator_.erase_gate_if_unused(step->scene);
}

awaitable<void> SeatGroups::watch(std::shared_ptr<Coordinator> self, std::shared_ptr<SeatPush> step) {
  const auto between = duration_of(self->options().notice_seconds);
  while (!step->over) {
    const TimePoint next = now() + between;
    step->timer.expires_at(step->ordered ? std::min(next, step->end) : next);
    co_await step->timer.async_wait(kAwait);
    if (step->over) break;
    if (step->ordered && now() >= step->end) {
      tell_pushing(step->contributions, FrameType::failure,
                   wire::failure_json({Code::deadline_exceeded,
                                       fmt::format("step {} wasn't committed at its deadline; it goes on", step->step),
                                       "push it again to hear what came of it"}));
      step->over = true;
      break;
    }
    const std::string notice = fmt::format("step {} of scene '{}' has waited {:.0f} s for {}", step->step, step->scene,
                                           seconds_since(step->started), step->ordered ? "the engine" : missing(*step));
    tell_pushing(step->contributions, FrameType::notice, {{"notice", notice}});
  }
}

}  // namespace rcb::net
