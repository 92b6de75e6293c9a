// MemberGroups, part 2: a step of all members, from the first push.begin to the last answer.
#include <algorithm>
#include <array>
#include <utility>

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include "common/wire/limits.hpp"
#include "server/api/ledger_answers.hpp"
#include "server/net/control/coordinator.hpp"
#include "server/net/control/members.hpp"

namespace rcb::net {

using wire::FrameType;
using wire::Json;

namespace {

// As a member's answer has them behind its own, with its field "cuts".
bool is_of_cuts(const wire::Array& array) {
  return array.name == "axes" || array.name == "at" || array.name == "id" || array.name == "part_sizes";
}

// Copies the arrays for one member: changes, places and cuts only if its push.begin asked for them, and what was
// inserted only if it inserted any. False if there is no memory for them.
bool copy_for(const Json& begin, const std::vector<wire::Array>& arrays, std::vector<wire::Array>& copy) {
  const auto inserted = wire::integer_field_or(begin, "inserted", 0, wire::kParticlesMax, 0);
  const bool inserts = inserted.ok() && *inserted > 0;
  for (const wire::Array& array : arrays) {
    if ((!wire::is_true(begin, "changes") && array.name.starts_with("changed_")) ||
        (!wire::is_true(begin, "places") && array.name.starts_with("place_")) ||
        (!begin.contains("cuts_known") && is_of_cuts(array)) || (!inserts && array.name.starts_with("inserted_")))
      continue;
    wire::Array& own = copy.emplace_back(wire::Array{array.name, array.dtype, array.shape, {}});
    if (!own.bytes.try_reserve(array.bytes.size())) return false;
    own.bytes.assign(array.bytes.span());
  }
  return true;
}

const char* as(bool refill) { return refill ? " (refill)" : ""; }

// Whether the push brings particles whose weights its flag `weights` is about. Who has none need not say it.
bool weights_matter(const PushTerms& terms) { return terms.n > 0; }

// Whether the members push weights: what those say who bring particles; if nobody does, what any says.
bool weights_of(const MemberPush& step) {
  bool any = false;
  for (const auto& contribution : step.contributions) {
    const PushTerms& terms = contribution->slices.terms();
    if (weights_matter(terms)) return terms.weights;
    any = any || terms.weights;
  }
  return any;
}

}  // namespace

Status MemberGroups::begin(ContributionBegin begin) {
  const std::string& scene = begin.id.scene;
  Group* group = find(scene);
  // While this push.begin waited for its turn, another generation may have taken the seat, or the scene was dropped.
  const auto seat = group == nullptr ? std::nullopt : seat_of(*group, begin.connection.get());
  if (!seat)
    return {Code::aborted, fmt::format("another generation of this member has opened scene '{}'", scene),
            "open the scene again with a higher generation"};
  const std::size_t member = *seat;
  const scene::Ledger* ledger = coordinator_.scenes().find(scene);
  if (ledger == nullptr) return coordinator_.unknown_scene(scene);
  const scene::SceneState& info = ledger->now();
  const bool refill = wire::is_true(begin.json, "refill");
  if (refill && (info.filled || info.step != begin.id.step)) return not_lacking(begin.id);
  if (!refill && info.step && begin.id.step <= *info.step)
    return answer_again(*group, *ledger, member, begin) ? Status()
                                                        : scene::stale_step(scene, begin.id.step, *info.step);
  const auto open = coordinator_.gate(scene).push;
  std::shared_ptr<MemberPush> step = open ? open->round : nullptr;
  if (step && (step->step != begin.id.step || step->refill != refill))
    return {Code::invalid_argument,
            fmt::format("member {} pushes step {}{}, the others push step {}{}", member, begin.id.step, as(refill),
                        step->step, as(step->refill)),
            "all members push the same step"};
  if (step && step->contributions[member]) {
    const PushId& older = step->contributions[member]->slices.terms().id;
    if (older.session != begin.id.session || older.attempt >= begin.id.attempt)
      return {Code::busy, fmt::format("member {} is pushing step {} already", member, step->step), "finish it first"};
    withdraw(*step, member, {Code::aborted, "a newer attempt of the same session replaced it"});
  }
  auto terms = read_terms(begin, info, step.get());
  Status refused = terms.status();
  if (refused.ok() && terms->to_ranks() && !group->follow)
    refused = {Code::unsupported, "members that don't follow their parts push in order \"id\""};
  if (!refused.ok() && step && !step->begun()) abort(step, nullptr, refused);
  if (!refused.ok()) return refused;
  if (step && step->to_ranks() && !terms->to_ranks()) withdraw_direct(*step, member);
  if (!step) step = open_step(scene, begin.id.step, *group);
  step->refill = refill;
  answer_count(*group, {{"send", fmt::format("{} pushes this step", name(scene, member))}});
  auto contribution = std::make_shared<OpenPush>(coordinator_.context(), std::move(*terms));
  contribution->connection = std::move(begin.connection);
  contribution->client = std::move(begin.client);
  contribution->request = begin.request;
  contribution->begin = std::move(begin.json);
  contribution->held = std::move(begin.held);
  contribution->round = step;
  contribution->member = static_cast<int>(member);
  contribution->end = begin.end;
  step->contributions[member] = contribution;
  if (begin.end < step->end) {
    step->end = begin.end;
    coordinator_.arm(step->front.lock(), begin.end);
  }
  if (contribution->slices.terms().direct()) coordinator_.receive_directly(contribution);
  if (Status counted = check_counts(*step); !counted.ok()) abort(step, nullptr, counted);
  if (contribution->given_up) return {};
  if (contribution->ready())
    contribution_whole(contribution);
  else
    coordinator_.arm(contribution, begin.end);
  return {};
}

void MemberGroups::withdraw_direct(MemberPush& step, std::size_t because_of) {
  const Status why(Code::stale_plan,
                   fmt::format("step {} of scene '{}': {} pushes by ids, so all members do", step.step, step.scene,
                               name(step.scene, because_of)),
                   "push this step in order \"id\"");
  for (std::size_t member = 0; member < step.contributions.size(); ++member)
    if (step.contributions[member]) withdraw(step, member, why);
}

void MemberGroups::withdraw(MemberPush& step, std::size_t member, const Status& why) {
  const auto contribution = std::exchange(step.contributions[member], nullptr);
  contribution->given_up = true;
  coordinator_.give_back(*contribution);
  if (contribution->slices.terms().to_ranks()) coordinator_.refuse_directly(contribution->slices.terms().id);
  contribution->connection->send(FrameType::failure, contribution->request, wire::failure_json(why));
  // Its deadline is the others' no more.
  step.end = TimePoint::max();
  for (const auto& one : step.contributions)
    if (one) step.end = std::min(step.end, one->end);
  coordinator_.arm(step.front.lock(), std::min(step.end, now() + duration_of(wire::kDeadlineSecondsMax)));
}

Status MemberGroups::check_counts(const MemberPush& step) const {
  if (std::find(step.contributions.begin(), step.contributions.end(), nullptr) != step.contributions.end()) return {};
  const scene::SceneState& scene = coordinator_.scenes().find(step.scene)->now();
  const auto differ = [&](std::uint64_t count, const std::string& whose, std::uint64_t held) {
    return Status(step.to_ranks() ? Code::stale_plan : Code::invalid_argument,
                  fmt::format("step {} of scene '{}': the members push {} particles of {}, which has {}", step.step,
                              step.scene, count, whose, held),
                  "push this step in order \"id\", all particles; that names those that no member has, or two");
  };
  std::uint64_t n = 0;
  bool all = true, few = false;
  for (const auto& contribution : step.contributions) {
    n += contribution->slices.terms().n;
    all = all && contribution->slices.terms().moved == Moved::all;
    few = few || contribution->slices.terms().moved == Moved::some;
  }
  if (!step.to_ranks() && all) return {};  // every id is checked
  if (n != scene.n) return differ(n, "the scene", scene.n);
  // Of some members only those that moved are counted, which each rank checks by their slots.
  for (std::size_t rank = 0; step.to_ranks() && !few && rank < scene.rank_counts.size(); ++rank) {
    std::uint64_t count = 0;
    for (const auto& contribution : step.contributions) count += contribution->slices.terms().counts[rank];
    if (count != scene.rank_counts[rank]) return differ(count, fmt::format("rank {}", rank), scene.rank_counts[rank]);
  }
  return {};
}

std::shared_ptr<MemberPush> MemberGroups::open_step(const std::string& scene, std::int64_t step, const Group& group) {
  PushTerms none;
  none.id.scene = scene;
  none.id.step = step;
  const auto front =
      coordinator_.open_push(std::move(none), nullptr, "the members of the scene", wire::kDeadlineSecondsMax);
  auto round = std::make_shared<MemberPush>(coordinator_.context(), scene, step);
  round->contributions.resize(group.seats.size());
  round->front = front;
  front->round = round;
  asio::co_spawn(coordinator_.context(), watch(coordinator_.shared_from_this(), round), asio::detached);
  return round;
}

Result<PushTerms> MemberGroups::read_terms(const ContributionBegin& begin, const scene::SceneState& info,
                                           const MemberPush* step) const {
  auto terms = read_push_terms(begin.json, begin.id, info, coordinator_.options().ranks,
                               coordinator_.options().bulk_bytes_max, Pusher::member);
  if (!terms.ok()) return terms.status();
  if (step != nullptr && step->begun() && terms->to_ranks() && !step->to_ranks())
    return Status(Code::stale_plan,
                  fmt::format("other members push step {} of scene '{}' by ids, so all do", begin.id.step, step->scene),
                  "push this step in order \"id\"");
  if (step == nullptr) return terms;
  for (const auto& contribution : step->contributions) {
    if (!contribution) continue;
    const PushTerms& other = contribution->slices.terms();
    if (other.weights != terms->weights && weights_matter(other) && weights_matter(*terms))
      return Status(Code::invalid_argument,
                    fmt::format("this push {} weights, that of member {} does{}", terms->weights ? "has" : "has no",
                                contribution->member, terms->weights ? " not" : ""),
                    "all members push weights, or none does");
    if (other.inserted > 0 && terms->inserted > 0 && other.inserted_ids != terms->inserted_ids)
      return Status(
          Code::invalid_argument,
          fmt::format("this push gives {} ids to what it inserts, that of member {} does{}",
                      terms->inserted_ids ? "its own" : "no", contribution->member, terms->inserted_ids ? " not" : ""),
          "all members that insert give ids, or none does");
  }
  return terms;
}

bool MemberGroups::answer_again(const Group& group, const scene::Ledger& ledger, std::size_t member,
                                const ContributionBegin& begin) {
  const auto& last = group.last;
  const bool here = last && begin.id.step == last->step && begin.id.step == ledger.now().step &&
                    member < last->sessions.size() && last->sessions[member] == begin.id.session;
  const scene::MemberShare* share = here ? nullptr : ledger.share_in_last(begin.id.session, begin.id.step);
  if (!here && share == nullptr) return false;
  if (may_bring_slices(begin.json)) coordinator_.refuse_directly(begin.id);
  if (here)
    send(*last, member, *begin.connection, begin.request, begin.json, true);
  else
    begin.connection->send(FrameType::reply, begin.request, api::repeated_to_member(ledger, *share));
  return true;
}

void MemberGroups::send(const Answers& answers, std::size_t member, Connection& connection, std::uint64_t request,
                        const Json& begin, bool repeated) {
  Json json = answers.json;
  if (repeated) json["repeated"] = true;
  if (!begin.contains("cuts_known")) json.erase("cuts");
  std::vector<wire::Array> arrays;
  const bool copied = copy_for(begin, answers.arrays[member], arrays) && copy_for(begin, answers.cuts, arrays);
  const Status sent =
      copied ? connection.send_message(FrameType::reply, request, std::move(json), std::move(arrays))
             : Status(Code::busy, "the step is committed, and there is no memory for its answer", "push it again");
  if (!sent.ok()) connection.send(FrameType::failure, request, wire::failure_json(sent));
}

void MemberGroups::contribution_whole(const std::shared_ptr<OpenPush>& contribution) {
  const auto step = contribution->round;
  const bool all = std::all_of(step->contributions.begin(), step->contributions.end(),
                               [](const auto& one) { return one && one->ready(); });
  if (all) order(step);
}

namespace {

// By what the ranks find a contribution: the number of its slices, or where it is in the memory that they share.
Json staged_by(const OpenPush& contribution) {
  const PushTerms& terms = contribution.slices.terms();
  if (!terms.from_memory()) return contribution.number;
  return {{"number", contribution.number},
          {"sockets", terms.by_socket},
          {"session", terms.id.session},
          {"memory", contribution.begin.at("memory")},
          {"n", terms.n},
          {"dtype", terms.is_float32 ? "<f4" : "<f8"},
          {"counts", terms.counts}};
}

}  // namespace

void MemberGroups::order(const std::shared_ptr<MemberPush>& step) {
  const bool to_ranks = step->to_ranks();
  Json request{{"command", "push.members"},
               {"scene", step->scene},
               {"session", kMembersSession},
               {"step", step->step},
               {"order", to_ranks ? "plan" : "id"}};
  OrderOptions order;
  PushTerms all;  // of all members together
  std::array<std::size_t, 3> members_by_moved{};
  std::vector<std::uint64_t> counts(to_ranks ? static_cast<std::size_t>(coordinator_.options().ranks) : 1, 0);
  bool changes = false;
  bool places = find(step->scene)->follow;  // only if all ask: without places a member can't use the direct path next
  for (const auto& contribution : step->contributions) {
    const PushTerms& terms = contribution->slices.terms();
    all.n += terms.n;
    all.inserted += terms.inserted;
    all.removed += terms.removed;
    all.inserted_ids = all.inserted_ids || terms.inserted_ids;
    order.members.push_back({scene::session_key(terms.id.session), all.inserted - terms.inserted});
    if (terms.step_seconds) all.step_seconds = std::max(*terms.step_seconds, all.step_seconds.value_or(0));
    if (terms.base_step) all.base_step = terms.base_step;
    if (terms.cuts_known && all.cuts_known.value_or(*terms.cuts_known) != *terms.cuts_known)
      all.cuts_known.emplace();  // no cuts are those that all of them know
    else if (terms.cuts_known)
      all.cuts_known = terms.cuts_known;
    ++members_by_moved[static_cast<std::size_t>(terms.moved)];
    request["moved_by"].push_back(name_of(terms.moved));
    if (!to_ranks) counts[0] += terms.moving();
    if (to_ranks && terms.moved == Moved::some)
      for (std::size_t rank = 0; rank < counts.size(); ++rank) counts[rank] += terms.counts[rank];
    changes = changes || wire::is_true(contribution->begin, "changes");
    places = places && wire::is_true(contribution->begin, "places");
    if (to_ranks) request["staged"].push_back(staged_by(*contribution));
    order.charged_bytes += std::exchange(contribution->charged_bytes, 0);
    for (Slice& slice : contribution->slices.take()) {
      if (slice.count == 0) continue;  // it may have other arrays than those of the members that bring particles
      slice.member = contribution->member;
      order.slices.push_back(std::move(slice));
    }
  }
  const std::size_t members = step->contributions.size();
  const bool any_all = members_by_moved[static_cast<std::size_t>(Moved::all)] > 0;
  if (members_by_moved[static_cast<std::size_t>(Moved::none)] == members)
    all.moved = Moved::none;
  else if (to_ranks ? !any_all : members_by_moved[static_cast<std::size_t>(Moved::all)] < members)
    all.moved = Moved::some;
  // Particles that no member names stay where they were.
  if (!to_ranks && all.moved != Moved::all) all.n = coordinator_.scenes().find(step->scene)->now().n;
  request["counts"] = counts;
  if (to_ranks) request["plan"] = step->contributions.front()->begin["plan"];
  if (step->refill) request["refill"] = true;
  if (all.base_step) request["base_step"] = *all.base_step;
  if (all.cuts_known)
    request["cuts_known"] = {{"epoch", all.cuts_known->epoch}, {"hash", wire::hex64(all.cuts_known->hash)}};
  if (all.step_seconds) request["step_seconds"] = *all.step_seconds;
  request["n"] = all.n;
  request["moved"] = name_of(all.moved);
  request["ids"] = !to_ranks && all.moved == Moved::all;
  request["inserted"] = all.inserted;
  request["removed"] = all.removed;
  request["inserted_ids"] = all.inserted_ids;
  request["changes"] = changes;
  request["places"] = places;
  coordinator_.add_terms(request, all.step_seconds);
  request["weights"] = weights_of(*step);
  request["members"] = members;
  order.received_seconds = seconds_since(step->started);
  order.deadline_seconds = std::chrono::duration<double>(step->end - step->started).count();
  request["deadline_seconds"] = order.deadline_seconds;
  order.changes = step->scene;
  const std::shared_ptr<Coordinator> coordinator = coordinator_.shared_from_this();
  order.then = [coordinator, step](Answer answer) { coordinator->groups().answered(step, std::move(answer)); };
  coordinator_.close_push(step->front.lock());
  step->ordered = true;
  const auto pending = coordinator_.order(std::move(request), std::move(order));
  coordinator_.erase_gate_if_unused(step->scene);
  if (pending.ok()) return;
  for (const auto& contribution : step->contributions)
    if (to_ranks) coordinator_.refuse_directly(contribution->slices.terms().id);
  answered(step, {pending.status(), Json::object(), {}});
}

void MemberGroups::answered(const std::shared_ptr<MemberPush>& step, Answer answer) {
  const auto contributions = std::exchange(step->contributions, {});
  const bool told = std::exchange(step->over, true);
  step->timer.cancel();
  if (!answer.status.ok()) {
    spdlog::info("step {} of scene '{}' by {} members: {}: {}", step->step, step->scene, contributions.size(),
                 code_name(answer.status.code()), answer.status.message());
    for (const auto& contribution : contributions)
      if (!told)
        contribution->connection->send(FrameType::failure, contribution->request, wire::failure_json(answer.status));
    return;
  }
  Answers kept;
  kept.step = step->step;
  kept.json = std::move(answer.json);
  const auto cuts = std::ranges::find_if(answer.arrays, is_of_cuts);
  kept.cuts.assign(std::make_move_iterator(cuts), std::make_move_iterator(answer.arrays.end()));
  answer.arrays.erase(cuts, answer.arrays.end());
  const std::size_t each = answer.arrays.size() / contributions.size();
  auto next = std::make_move_iterator(answer.arrays.begin());
  for (const auto& contribution : contributions) {
    kept.sessions.push_back(contribution->slices.terms().id.session);
    kept.arrays.emplace_back(next, next + static_cast<std::ptrdiff_t>(each));
    next += static_cast<std::ptrdiff_t>(each);
    if (!told)
      send(kept, static_cast<std::size_t>(contribution->member), *contribution->connection, contribution->request,
           contribution->begin, false);
  }
  Group* group = find(step->scene);
  if (group != nullptr && !step->refill && group->seats.size() == contributions.size()) group->last = std::move(kept);
}

void MemberGroups::abort(const std::shared_ptr<MemberPush>& step, const OpenPush* contribution, const Status& why) {
  if (step->ordered || step->over) return;
  const auto front = step->front.lock();
  const std::string who =
      contribution != nullptr ? name(step->scene, static_cast<std::size_t>(contribution->member)) + ": " : "";
  const Status named(why.code(), who + why.message(), why.hint());
  spdlog::info("step {} of scene '{}' by {} members given up: {}", step->step, step->scene, step->contributions.size(),
               named.message());
  step->over = true;
  step->timer.cancel();
  front->given_up = true;
  coordinator_.close_push(front);
  for (const auto& one : std::exchange(step->contributions, {})) {
    if (!one) continue;
    one->given_up = true;
    if (one->number != 0) coordinator_.refuse_directly(one->slices.terms().id);
    coordinator_.give_back(*one);
    one->connection->send(FrameType::failure, one->request, wire::failure_json(named));
  }
  coordinator_.erase_gate_if_unused(step->scene);
}

awaitable<void> MemberGroups::watch(std::shared_ptr<Coordinator> self, std::shared_ptr<MemberPush> step) {
  const auto between = duration_of(self->options().notice_seconds);
  while (!step->over) {
    const TimePoint next = now() + between;
    step->timer.expires_at(step->ordered ? std::min(next, step->end) : next);
    co_await step->timer.async_wait(kAwait);
    if (step->over) break;
    if (step->ordered && now() >= step->end) {
      for (const auto& contribution : step->contributions)
        contribution->connection->send(
            FrameType::failure, contribution->request,
            wire::failure_json({Code::deadline_exceeded,
                                fmt::format("step {} wasn't committed at its deadline; it goes on", step->step),
                                "push it again to hear what came of it"}));
      step->over = true;
      break;
    }
    const std::string notice = fmt::format("step {} of scene '{}' has waited {:.0f} s for {}", step->step, step->scene,
                                           seconds_since(step->started), step->ordered ? "the engine" : missing(*step));
    for (const auto& contribution : step->contributions)
      if (contribution) contribution->connection->send(FrameType::notice, contribution->request, {{"notice", notice}});
  }
}

}  // namespace rcb::net
