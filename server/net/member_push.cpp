// MemberGroups, part 2: a step that all members push, from the first one's push.begin to everybody's answer.
#include <algorithm>
#include <utility>

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include "server/net/coordinator.hpp"
#include "server/net/members.hpp"

namespace rcb::net {

using wire::FrameType;
using wire::Json;

namespace {

bool asked(const Json& begin, const char* name) {
  const auto value = wire::bool_field_or(begin, name, false);
  return value.ok() && *value;
}

// A copy for one who is told: changes and places only where they were asked for.
std::vector<wire::Array> copy_for(const Json& begin, const std::vector<wire::Array>& arrays) {
  std::vector<wire::Array> copy;
  for (const wire::Array& array : arrays)
    if ((asked(begin, "changes") || !array.name.starts_with("changed_")) &&
        (asked(begin, "places") || !array.name.starts_with("place_")))
      copy.push_back(array);
  return copy;
}

}  // namespace

Status MemberGroups::begin(ShareBegin begin) {
  const std::string& scene = begin.id.scene;
  Group* group = find(scene);
  // While this push.begin waited for its turn the seat may have been taken, or the scene dropped.
  const auto nobody = std::vector<Seat>::iterator();
  const auto seat =
      group == nullptr ? nobody : std::find_if(group->seats.begin(), group->seats.end(), [&](const Seat& one) {
        return one.connection == begin.connection.get();
      });
  if (group == nullptr || seat == group->seats.end())
    return {Code::aborted, fmt::format("another generation of this member has opened scene '{}'", scene),
            "open the scene again with a higher generation"};
  const auto member = static_cast<std::size_t>(seat - group->seats.begin());
  if (const MemberAnswers* before = kept_.before(scene); before != nullptr && answer_again(*before, member, begin))
    return {};
  const auto info = coordinator_.snapshot().find(scene);
  if (info == coordinator_.snapshot().end()) return coordinator_.unknown_scene(scene);
  if (info->second.step && begin.id.step <= *info->second.step) {
    if (group->last && answer_again(*group->last, member, begin)) return {};
    return {
        Code::stale_step,
        fmt::format("step {} of scene '{}' is not above the last one, {}", begin.id.step, scene, *info->second.step),
        fmt::format("push step {} or a later one", *info->second.step + 1)};
  }
  const auto open = coordinator_.gate(scene).push;
  std::shared_ptr<MemberPush> step = open ? open->together : nullptr;
  if (step && step->step != begin.id.step)
    return {Code::invalid_argument,
            fmt::format("member {} pushes step {}, the others push step {}", member, begin.id.step, step->step),
            "all members push the same step"};
  if (step && step->shares[member])
    return {Code::busy, fmt::format("member {} is pushing step {} already", member, step->step), "finish it first"};
  auto terms = read_terms(begin, info->second, step.get());
  if (!terms.ok()) return terms.status();
  if (terms->direct && !group->follow)
    return {Code::unsupported, "members that don't follow their parts push in order \"id\""};
  if (step && step->direct() && !terms->direct) withdraw_direct(*step, member);
  if (!step) step = open_step(scene, begin.id.step, *group);
  auto share = std::make_shared<OpenPush>(coordinator_.context(), std::move(*terms));
  share->connection = std::move(begin.connection);
  share->client = std::move(begin.client);
  share->request = begin.request;
  share->begin = std::move(begin.json);
  share->together = step;
  share->member = static_cast<int>(member);
  step->shares[member] = share;
  if (begin.end < step->end) {
    step->end = begin.end;
    coordinator_.arm(step->front.lock(), begin.end);
  }
  if (share->slices.terms().direct) {
    coordinator_.receive_directly(share);
    if (Status counted = check_counts(*step); !counted.ok()) give_up(step, nullptr, counted);
  }
  if (share->given_up) return {};
  if (share->ready())
    share_whole(share);
  else
    coordinator_.arm(share, begin.end);
  return {};
}

void MemberGroups::withdraw_direct(MemberPush& step, std::size_t because_of) {
  const Status why(Code::stale_plan,
                   fmt::format("step {} of scene '{}': {} pushes by ids, so all members do", step.step, step.scene,
                               name(step.scene, because_of)),
                   "push this step in order \"id\"");
  for (auto& one : step.shares) {
    if (!one) continue;
    const auto share = std::exchange(one, nullptr);
    share->given_up = true;
    coordinator_.give_back(*share);
    coordinator_.refuse_directly(share->slices.terms().id);
    share->connection->send(FrameType::failure, share->request, wire::failure_json(why));
  }
}

Status MemberGroups::check_counts(const MemberPush& step) const {
  if (std::find(step.shares.begin(), step.shares.end(), nullptr) != step.shares.end()) return {};
  const auto& held = coordinator_.snapshot().at(step.scene).rank_counts;
  for (std::size_t rank = 0; rank < held.size(); ++rank) {
    std::uint64_t count = 0;
    for (const auto& share : step.shares) count += share->slices.terms().counts[rank];
    if (count != held[rank])
      return {Code::stale_plan,
              fmt::format("step {} of scene '{}': the members push {} particles of rank {}, which holds {}", step.step,
                          step.scene, count, rank, held[rank]),
              "push this step in order \"id\""};
  }
  return {};
}

std::shared_ptr<MemberPush> MemberGroups::open_step(const std::string& scene, std::int64_t step, const Group& group) {
  PushTerms none;
  none.id.scene = scene;
  none.id.step = step;
  const auto front =
      coordinator_.open_push(std::move(none), nullptr, "the members of the scene", wire::kDeadlineSecondsMax);
  auto together = std::make_shared<MemberPush>(coordinator_.context(), scene, step);
  together->shares.resize(group.seats.size());
  together->front = front;
  front->together = together;
  asio::co_spawn(coordinator_.context(), watch(coordinator_.shared_from_this(), together), asio::detached);
  return together;
}

Result<PushTerms> MemberGroups::read_terms(const ShareBegin& begin, const api::SceneSummary& info,
                                           const MemberPush* step) const {
  auto terms = read_push_terms(begin.json, begin.id, info, coordinator_.options().ranks,
                               coordinator_.options().bulk_bytes_max, Pusher::member);
  if (!terms.ok()) return terms.status();
  if (step != nullptr && terms->direct && !step->direct())
    return Status(Code::stale_plan,
                  fmt::format("other members push step {} of scene '{}' by ids, so all do", begin.id.step, step->scene),
                  "push this step in order \"id\"");
  if (step != nullptr)
    for (const auto& share : step->shares)
      if (share && share->slices.terms().weights != terms->weights)
        return Status(Code::invalid_argument,
                      fmt::format("this push {} weights, that of member {} does{}", terms->weights ? "has" : "has no",
                                  share->member, terms->weights ? " not" : ""),
                      "all members push weights, or none does");
  return terms;
}

bool MemberGroups::answer_again(const MemberAnswers& answers, std::size_t member, const ShareBegin& begin) {
  if (answers.step != begin.id.step || member >= answers.sessions.size() ||
      answers.sessions[member] != begin.id.session)
    return false;
  if (begin.json.value("path", Json()) == "direct") coordinator_.refuse_directly(begin.id);
  Json json = answers.json;
  json["repeated"] = true;
  static_cast<void>(begin.connection->send_message(FrameType::reply, begin.request, std::move(json),
                                                   copy_for(begin.json, answers.arrays[member])));
  return true;
}

void MemberGroups::share_whole(const std::shared_ptr<OpenPush>& share) {
  const auto step = share->together;
  const bool all =
      std::all_of(step->shares.begin(), step->shares.end(), [](const auto& one) { return one && one->ready(); });
  if (all) order(step);
}

void MemberGroups::order(const std::shared_ptr<MemberPush>& step) {
  const bool direct = step->direct();
  Json request{{"command", "push.members"},       {"scene", step->scene}, {"session", "members"}, {"step", step->step},
               {"order", direct ? "plan" : "id"}, {"ids", !direct}};
  OrderOptions order;
  std::uint64_t n = 0;
  bool changes = false;
  bool places = find(step->scene)->follow;  // all ask for them: who has none could not use the direct path next
  Json unmoved = Json::array();
  double seconds = -1;
  for (const auto& share : step->shares) {
    n += share->slices.terms().n;
    changes = changes || asked(share->begin, "changes");
    places = places && asked(share->begin, "places");
    if (direct) request["staged"].push_back(share->number);
    if (share->slices.terms().moved == Moved::none) unmoved.push_back(share->member);
    if (share->begin.contains("step_seconds") && share->begin["step_seconds"].is_number())
      seconds = std::max(seconds, share->begin["step_seconds"].get<double>());
    order.charged_bytes += std::exchange(share->charged_bytes, 0);
    for (Slice& slice : share->slices.take()) {
      slice.rank = share->member;
      order.slices.push_back(std::move(slice));
    }
  }
  request["n"] = n;
  if (direct) {
    request["plan"] = step->shares.front()->begin["plan"];
    request["base_step"] = step->shares.front()->begin["base_step"];
    request["moved"] = unmoved.size() == step->shares.size() ? "none" : "all";
    request["unmoved"] = std::move(unmoved);
  }
  request["changes"] = changes;
  request["places"] = places;
  request["weights"] = step->shares.front()->slices.terms().weights;
  request["members"] = step->shares.size();
  request["follow"] = find(step->scene)->follow;
  if (seconds >= 0) request["step_seconds"] = seconds;
  order.received_seconds = seconds_since(step->started);
  order.deadline_seconds = std::chrono::duration<double>(step->end - step->started).count();
  request["deadline_seconds"] = order.deadline_seconds;
  order.changes = step->scene;
  const std::shared_ptr<Coordinator> coordinator = coordinator_.shared_from_this();
  order.then = [coordinator, step](Answer answer) { coordinator->groups().answered(step, std::move(answer)); };
  coordinator_.close_push(step->front.lock());
  step->ordered = true;
  const auto pending = coordinator_.order(std::move(request), std::move(order));
  coordinator_.tidy(step->scene);
  if (pending.ok()) return;
  for (const auto& share : step->shares)
    if (direct) coordinator_.refuse_directly(share->slices.terms().id);
  answered(step, {pending.status(), Json::object(), {}});
}

void MemberGroups::answered(const std::shared_ptr<MemberPush>& step, Answer answer) {
  const auto shares = std::exchange(step->shares, {});
  const bool told = std::exchange(step->over, true);
  step->timer.cancel();
  if (!answer.status.ok()) {
    spdlog::info("step {} of scene '{}' by {} members: {}: {}", step->step, step->scene, shares.size(),
                 code_name(answer.status.code()), answer.status.message());
    for (const auto& share : shares)
      if (!told) share->connection->send(FrameType::failure, share->request, wire::failure_json(answer.status));
    return;
  }
  MemberAnswers kept{step->step, {}, std::move(answer.json), {}};
  const std::size_t each = answer.arrays.size() / shares.size();
  auto next = std::make_move_iterator(answer.arrays.begin());
  for (const auto& share : shares) {
    kept.sessions.push_back(share->slices.terms().id.session);
    kept.arrays.emplace_back(next, next + static_cast<std::ptrdiff_t>(each));
    next += static_cast<std::ptrdiff_t>(each);
  }
  kept_.keep(step->scene, kept);  // before anyone hears of it
  for (std::size_t member = 0; member < shares.size() && !told; ++member) {
    const OpenPush& share = *shares[member];
    const Status sent = share.connection->send_message(FrameType::reply, share.request, kept.json,
                                                       copy_for(share.begin, kept.arrays[member]));
    if (!sent.ok()) share.connection->send(FrameType::failure, share.request, wire::failure_json(sent));
  }
  if (Group* group = find(step->scene); group != nullptr && group->seats.size() == shares.size())
    group->last = std::move(kept);
}

void MemberGroups::give_up(const std::shared_ptr<MemberPush>& step, const OpenPush* share, const Status& why) {
  if (step->ordered || step->over) return;
  const auto front = step->front.lock();
  const std::string who = share != nullptr ? name(step->scene, static_cast<std::size_t>(share->member)) + ": " : "";
  const Status named(why.code(), who + why.message(), why.hint());
  spdlog::info("step {} of scene '{}' by {} members given up: {}", step->step, step->scene, step->shares.size(),
               named.message());
  step->over = true;
  step->timer.cancel();
  front->given_up = true;
  coordinator_.close_push(front);
  for (const auto& one : std::exchange(step->shares, {})) {
    if (!one) continue;
    one->given_up = true;
    if (one->number != 0) coordinator_.refuse_directly(one->slices.terms().id);
    coordinator_.give_back(*one);
    one->connection->send(FrameType::failure, one->request, wire::failure_json(named));
  }
  coordinator_.tidy(step->scene);
}

awaitable<void> MemberGroups::watch(std::shared_ptr<Coordinator> self, std::shared_ptr<MemberPush> step) {
  const auto between = duration_of(self->options().notice_seconds);
  while (!step->over) {
    const TimePoint next = now() + between;
    step->timer.expires_at(step->ordered ? std::min(next, step->end) : next);
    co_await step->timer.async_wait(kAwait);
    if (step->over) break;
    if (step->ordered && now() >= step->end) {
      for (const auto& share : step->shares)
        share->connection->send(
            FrameType::failure, share->request,
            wire::failure_json({Code::deadline_exceeded,
                                fmt::format("step {} wasn't committed at its deadline; it goes on", step->step),
                                "push it again to hear what came of it"}));
      step->over = true;
      break;
    }
    const std::string notice = fmt::format("step {} of scene '{}' has waited {:.0f} s for {}", step->step, step->scene,
                                           seconds_since(step->started), step->ordered ? "the engine" : missing(*step));
    for (const auto& share : step->shares)
      if (share) share->connection->send(FrameType::notice, share->request, {{"notice", notice}});
  }
}

}  // namespace rcb::net
