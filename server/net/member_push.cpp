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

// A copy for one who is told; changes only where they were asked for.
std::vector<wire::Array> copy_for(const Json& begin, const std::vector<wire::Array>& arrays) {
  std::vector<wire::Array> copy;
  for (const wire::Array& array : arrays)
    if (asked(begin, "changes") || !array.name.starts_with("changed_")) copy.push_back(array);
  return copy;
}

}  // namespace

Status MemberGroups::begin(ShareBegin begin) {
  const std::string& scene = begin.id.scene;
  Group* group = find(scene);
  CHECK(group != nullptr, "a member without a group");
  const auto seat = std::find_if(group->seats.begin(), group->seats.end(),
                                 [&](const Seat& one) { return one.connection == begin.connection.get(); });
  if (seat == group->seats.end())
    return {Code::aborted, fmt::format("another generation of this member has opened scene '{}'", scene),
            "open the scene again with a higher generation"};
  const auto member = static_cast<std::size_t>(seat - group->seats.begin());
  const auto info = coordinator_.snapshot().scenes.find(scene);
  if (info == coordinator_.snapshot().scenes.end()) return coordinator_.unknown_scene(scene);
  if (info->second.step && begin.id.step <= *info->second.step) {
    if (answer_again(*group, member, begin)) return {};
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
  if (Status room = coordinator_.take_bytes(terms->bytes()); !room.ok()) return room;
  if (!step) {
    auto opened = open_step(scene, begin.id.step, *group);
    if (!opened.ok()) return opened.status();
    step = std::move(*opened);
  }
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
  if (share->slices.whole()) share_whole(share);
  return {};
}

Result<std::shared_ptr<MemberPush>> MemberGroups::open_step(const std::string& scene, std::int64_t step,
                                                            const Group& group) {
  PushTerms none;
  none.id.scene = scene;
  none.id.step = step;
  auto front = coordinator_.open_push(std::move(none), nullptr, "the members of the scene", wire::kDeadlineSecondsMax);
  if (!front.ok()) return front.status();
  auto together = std::make_shared<MemberPush>(coordinator_.context(), scene, step);
  together->shares.resize(group.seats.size());
  together->front = *front;
  (*front)->together = together;
  asio::co_spawn(coordinator_.context(), watch(coordinator_.shared_from_this(), together), asio::detached);
  return together;
}

Result<PushTerms> MemberGroups::read_terms(const ShareBegin& begin, const SceneInfo& info,
                                           const MemberPush* step) const {
  SceneInfo free = info;  // a share has any number of particles, and no plan
  free.step.reset();
  auto terms =
      read_push_terms(begin.json, begin.id, free, coordinator_.options().ranks, coordinator_.options().bulk_bytes_max);
  if (!terms.ok()) return terms.status();
  if (terms->direct || !terms->by_id || !terms->ids)
    return Status(Code::unsupported, "members push by the path \"gateway\", in order \"id\", with \"ids\" true");
  if (terms->moved != Moved::all || terms->edit_slices() > 0)
    return Status(Code::unsupported, "members push all their particles, and neither insert nor remove any");
  if (step != nullptr)
    for (const auto& share : step->shares)
      if (share && share->slices.terms().weights != terms->weights)
        return Status(Code::invalid_argument,
                      fmt::format("this push {} weights, that of member {} does{}", terms->weights ? "has" : "has no",
                                  share->member, terms->weights ? " not" : ""),
                      "all members push weights, or none does");
  return terms;
}

bool MemberGroups::answer_again(const Group& group, std::size_t member, const ShareBegin& begin) {
  if (!group.last || group.last->step != begin.id.step || group.last->sessions[member] != begin.id.session)
    return false;
  Json json = group.last->json;
  json["repeated"] = true;
  static_cast<void>(begin.connection->send_message(FrameType::reply, begin.request, std::move(json),
                                                   copy_for(begin.json, group.last->arrays[member])));
  return true;
}

void MemberGroups::share_whole(const std::shared_ptr<OpenPush>& share) {
  const auto step = share->together;
  const bool all =
      std::all_of(step->shares.begin(), step->shares.end(), [](const auto& one) { return one && one->slices.whole(); });
  if (all) order(step);
}

void MemberGroups::order(const std::shared_ptr<MemberPush>& step) {
  Json request{{"command", "push.members"}, {"scene", step->scene}, {"session", "members"},
               {"step", step->step},        {"order", "id"},        {"ids", true}};
  OrderOptions order;
  std::uint64_t n = 0;
  bool changes = false;
  double seconds = -1;
  for (const auto& share : step->shares) {
    n += share->slices.terms().n;
    changes = changes || asked(share->begin, "changes");
    if (share->begin.contains("step_seconds") && share->begin["step_seconds"].is_number())
      seconds = std::max(seconds, share->begin["step_seconds"].get<double>());
    order.staged_bytes += share->slices.terms().bytes();
    for (Slice& slice : share->slices.take()) {
      slice.rank = share->member;
      order.slices.push_back(std::move(slice));
    }
  }
  request["n"] = n;
  request["changes"] = changes;
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
  if (!pending.ok()) answered(step, {pending.status(), Json::object(), {}, nullptr});
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
  Answered kept{step->step, {}, std::move(answer.json), {}};
  const std::size_t each = answer.arrays.size() / shares.size();
  auto next = std::make_move_iterator(answer.arrays.begin());
  for (const auto& share : shares) {
    kept.sessions.push_back(share->slices.terms().id.session);
    kept.arrays.emplace_back(next, next + static_cast<std::ptrdiff_t>(each));
    next += static_cast<std::ptrdiff_t>(each);
    if (told) continue;
    const Status sent = share->connection->send_message(FrameType::reply, share->request, kept.json,
                                                        copy_for(share->begin, kept.arrays.back()));
    if (!sent.ok()) share->connection->send(FrameType::failure, share->request, wire::failure_json(sent));
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
    coordinator_.give_bytes(one->slices.terms().bytes());
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
