// A step that the members of a parallel solver push together, each its own particles. If they push with ids, rank 0
// merges the members' contributions by id into a single push; if they push straight to the ranks, each rank has its
// slice. Afterwards rank 0 tells every member its results.
//
// Invariant: the resulting scene is the same as after a single client's push of the same particles.
#include <algorithm>
#include <cstring>
#include <numeric>

#include <fmt/format.h>

#include "common/layout/layout.hpp"
#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"
#include "server/service/commands/cuts_json.hpp"
#include "server/service/context/collective.hpp"
#include "server/service/step/member_results.hpp"
#include "server/service/step/step.hpp"

namespace rcb::service {
namespace {

struct MemberRequest {
  PushRequest push;
  ResultTerms answer;
};

Result<MemberRequest> read_member_push(const wire::Json& request, int ranks) {
  auto push = read_order(request, ranks);
  if (!push.ok()) return push.status();
  wire::FieldReader fields(request);
  const std::int64_t members = fields.integer("members", 1, wire::kSessionsMax);
  const bool places = fields.flag("places");
  if (!fields.ok()) return fields.status();
  const auto moved_by = request.find("moved_by");
  if (moved_by == request.end() || moved_by->size() != static_cast<std::size_t>(members) ||
      (push->staged && request.at("staged").size() != moved_by->size()))
    return Status(Code::invalid_argument, "field 'moved_by': expected a word for each member");
  for (const wire::Json& word : *moved_by)
    push->moved_by.push_back(word == "none" ? Moved::none : word == "some" ? Moved::some : Moved::all);
  if (push->staged) {
    const wire::Json& staged = request.at("staged");
    const bool all_share = std::all_of(staged.begin(), staged.end(), [](const auto& one) { return one.is_object(); });
    push->way = all_share ? api::Way::shared_memory : api::Way::sockets;
  }
  const bool changes = push->changes;
  const bool inserted = push->inserted > 0;
  return MemberRequest{std::move(*push), {static_cast<int>(members), changes, places, inserted}};
}

// Puts the slices of that kind, of all members in turn, behind one another, and tells which particle is whose.
PushSlice take_joined(std::vector<PushSlice>& slices, int kind, std::vector<std::int32_t>& members) {
  std::stable_sort(slices.begin(), slices.end(), [](const auto& a, const auto& b) { return a.member < b.member; });
  PushSlice joined{.rank = kind};
  for (PushSlice& slice : slices) {
    if (slice.rank != kind) continue;
    members.insert(members.end(), slice.count, slice.member);
    joined.count += slice.count;
    if (joined.arrays.empty()) {
      joined.arrays = std::move(slice.arrays);
      continue;
    }
    for (std::size_t a = 0; a < joined.arrays.size() && a < slice.arrays.size(); ++a)
      joined.arrays[a].bytes.append(std::as_const(slice.arrays[a].bytes).span());
  }
  for (wire::Array& array : joined.arrays) array.shape = {joined.count};
  std::erase_if(slices, [kind](const PushSlice& slice) { return slice.rank == kind; });
  return joined;
}

std::span<const particles::Id> ids_of(const PushSlice& slice) {
  return {reinterpret_cast<const particles::Id*>(slice.arrays.back().bytes.data()), slice.count};
}

Status check_shares(const std::vector<PushSlice>& slices, const Scene& scene, const MemberRequest& request) {
  const std::size_t arrays = static_cast<std::size_t>(scene.options.dims) + (request.push.weights ? 1U : 0U) + 1U;
  const std::uint64_t announced = request.push.moving();
  std::vector<bool> seen(static_cast<std::size_t>(request.answer.members), false);
  std::uint64_t count = 0;
  for (const PushSlice& slice : slices) {
    if (slice.rank < 0) continue;  // inserted or removed
    if (slice.member < 0 || slice.member >= request.answer.members || seen[static_cast<std::size_t>(slice.member)])
      return {Code::invalid_argument, fmt::format("two shares of member {}, or no such member", slice.member)};
    seen[static_cast<std::size_t>(slice.member)] = true;
    bool fits = slice.arrays.size() == arrays && slice.arrays.back().name == "id";
    for (const wire::Array& array : slice.arrays) fits = fits && array.bytes.size() == slice.count * 8;
    if (!fits)
      return {
          Code::invalid_argument,
          fmt::format("the share of member {} must have x (y, z), w where weights are pushed, and id", slice.member)};
    count += slice.count;
  }
  if (count == announced) return {};
  return {Code::invalid_argument, fmt::format("the shares have {} particles, {} are announced", count, announced)};
}

// Merges the contributions into one slice in ascending id; `joined` gets each particle's id and member.
Status join_shares(std::vector<PushSlice>& slices, std::uint64_t n, OfMembers& joined) {
  std::sort(slices.begin(), slices.end(), [](const PushSlice& a, const PushSlice& b) { return a.member < b.member; });
  Buffer<particles::Id> ids;
  Buffer<std::int32_t> members;
  Buffer<std::uint64_t> to_order;  // what putting them in order takes: asked for, and given back
  if (!to_order.try_reserve(2 * n) || !ids.try_reserve(n) || !members.try_reserve(n) || !joined.id.try_reserve(n) ||
      !joined.member.try_reserve(n))
    return {Code::too_large, fmt::format("no memory for {} particles", n)};
  to_order.release();
  for (const PushSlice& slice : slices) {
    ids.append(ids_of(slice));
    for (std::uint64_t i = 0; i < slice.count; ++i) members.push_back(slice.member);
  }
  const Buffer<std::uint64_t> order = ascending(ids);
  for (const std::uint64_t k : order) {
    joined.id.push_back(ids[k]);
    joined.member.push_back(members[k]);
  }
  for (std::uint64_t k = 1; k < n; ++k) {
    if (joined.id[k] != joined.id[k - 1]) continue;
    const std::int32_t a = joined.member[k - 1];
    const std::int32_t b = joined.member[k];
    return {Code::invalid_argument,
            a == b ? fmt::format("member {} pushes id {} twice", a, joined.id[k])
                   : fmt::format("id {} is pushed by member {} and by member {}", joined.id[k], a, b),
            "every id has one member"};
  }
  if (slices.empty()) return {};
  PushSlice whole{.count = n};
  for (std::size_t a = 0; a < slices.front().arrays.size(); ++a) {
    Buffer<std::byte> all, sorted;
    if (!all.try_reserve(n * 8) || !sorted.try_reserve(n * 8))
      return {Code::too_large, fmt::format("no memory for {} particles", n)};
    for (PushSlice& slice : slices) {
      all.append(std::as_const(slice.arrays[a].bytes).span());
      slice.arrays[a].bytes.release();
    }
    sorted.resize(n * 8);
    for (std::uint64_t k = 0; k < n; ++k) std::memcpy(sorted.data() + 8 * k, all.data() + 8 * order[k], 8);
    const wire::Array& like = slices.front().arrays[a];
    whole.arrays.push_back({like.name, like.dtype, {n}, std::move(sorted)});
  }
  slices.clear();
  slices.push_back(std::move(whole));
  return {};
}

// Checks that the pushed ids are exactly the scene's. scene_ids: ascending; empty if they are 0..n-1.
Status check_ids(const Scene& scene, const OfMembers& joined, const Buffer<particles::Id>& scene_ids) {
  for (std::uint64_t k = 0; k < std::max<std::uint64_t>(scene.n, joined.id.size()); ++k) {
    const bool there = k < joined.id.size();
    const bool known = k < scene.n;
    const particles::Id wanted = !known ? 0 : scene.ids ? scene_ids[k] : static_cast<particles::Id>(k);
    if (there && known && joined.id[k] == wanted) continue;
    const std::string hint = "the members together push all of the scene's particles";
    if (there && (!known || joined.id[k] < wanted))
      return {
          Code::invalid_argument,
          fmt::format("id {}, pushed by member {}, isn't in scene '{}'", joined.id[k], joined.member[k], scene.name),
          hint};
    return {Code::invalid_argument, fmt::format("id {} of scene '{}' is pushed by no member", wanted, scene.name),
            hint};
  }
  return {};
}

// Makes context.slices and `push` what they would be if a single client had pushed by id. Collective. Errors: faults of
// the contributions, the same on every rank.
Status merge(Context& context, const Scene& scene, MemberRequest& request, OfMembers& joined) {
  PushRequest& push = request.push;
  const bool all = push.moved == Moved::all;
  Buffer<particles::Id> scene_ids;
  if (scene.pushed && scene.ids && all) {
    constexpr std::uint64_t kBytesOfId = 24;  // as it comes, and as it is kept
    if (Status room = agree_room(context.comm, context.root() ? scene.n * kBytesOfId : 0,
                                 fmt::format("the ids of {} particles", scene.n));
        !room.ok())
      return room;
    scene_ids = gather_values<particles::Id>(context.comm, scene.particles.id.span());
    std::sort(scene_ids.begin(), scene_ids.end());
  }
  Status status;
  std::uint64_t own_ids = 0;
  if (context.root()) {
    status = check_shares(context.slices, scene, request);
    if (status.ok() && !scene.pushed)
      status = push.edits()
                   ? Status(Code::invalid_argument, "a first push inserts and removes nothing", "push all particles")
                   : join_shares(context.slices, push.n, joined);
    if (status.ok() && scene.pushed) {
      std::vector<PushSlice> edits;
      for (PushSlice& slice : context.slices)
        if (slice.rank < 0) edits.push_back(std::move(slice));
      std::erase_if(context.slices, [](const PushSlice& slice) { return slice.rank < 0; });
      status = join_shares(context.slices, push.moving(), joined);
      if (status.ok() && all) status = check_ids(scene, joined, scene_ids);
      for (PushSlice& slice : edits) context.slices.push_back(std::move(slice));
    }
    if (status.ok() && !scene.pushed)
      for (std::uint64_t k = 0; k < joined.id.size(); ++k)
        own_ids |= static_cast<std::uint64_t>(joined.id[k] != static_cast<particles::Id>(k));
  }
  if (Status agreed = agree_status(context.comm, status); !agreed.ok()) return agreed;
  context.comm.all_max({&own_ids, 1});
  push.by_id = true;
  push.ids = own_ids != 0;
  if (context.root() && all && !push.ids)
    for (PushSlice& slice : context.slices)
      if (slice.rank >= 0) slice.arrays.pop_back();
  return {};
}

// Bytes of the positions that members did not send since they have not moved.
std::uint64_t bytes_left_out(const Scene& scene, const PushRequest& push) {
  std::uint64_t left_out = 0;
  for (int p = 0; p < scene.options.parts; ++p)
    if (push.moved_by[static_cast<std::size_t>(layout::rank_of_part(p, scene.options.parts, push.members()))] !=
        Moved::all)
      left_out += scene.loads.counts[static_cast<std::size_t>(p)];
  const auto few = std::accumulate(push.counts.begin(), push.counts.end(), std::uint64_t{0});
  const auto point = static_cast<std::uint64_t>(scene.options.dims) * sizeof(double);
  return left_out * point - few * (point + sizeof(std::uint64_t));
}

Response push_members(Context& context, Scene& of, const wire::Json& request) {
  auto members = read_member_push(request, context.comm.size());
  if (!members.ok()) return failed(members.status());
  PushRequest& push = members->push;
  const ResultTerms& terms = members->answer;
  const double start = context.clock.seconds();
  // By ids, where all push all, every particle is named with its member. Else what has changed is found by comparing.
  const bool all = !push.staged && push.moved == Moved::all;
  const bool any_all = !push.staged && std::count(push.moved_by.begin(), push.moved_by.end(), Moved::all) > 0;
  MemberNews news;
  OfMembers& inserted = news.inserted;
  std::optional<PlacesBefore> before;
  if (!all && (terms.changes || terms.places)) before.emplace(of);
  if (!push.staged && push.moved != Moved::none)
    if (Status merged = merge(context, of, *members, news.pushed); !merged.ok()) return failed(merged);
  // Once the step has changed anything it must not lack memory for the answer.
  constexpr std::uint64_t kBytesGathered = 64;
  if (!all && any_all && terms.places)
    if (Status room = agree_room(context.comm, context.root() ? of.n * kBytesGathered : 0,
                                 fmt::format("the places of {} particles", of.n));
        !room.ok())
      return failed(std::move(room));
  if (context.root() && push.edits()) {
    std::vector<std::int32_t> inserted_by, removed_by;
    context.slices.push_back(take_joined(context.slices, wire::kInsertedSlice, inserted_by));
    if (push.inserted_ids && context.slices.back().count > 0) inserted.id.append(ids_of(context.slices.back()));
    inserted.member.append(std::span<const std::int32_t>(inserted_by));
    context.slices.push_back(take_joined(context.slices, wire::kRemovedSlice, removed_by));
    std::erase_if(context.slices, [](const PushSlice& slice) { return slice.rank < 0 && slice.count == 0; });
  }
  context.received_seconds += context.clock.seconds() - start;
  auto staged = prepare(context, of, push);
  if (!staged.ok()) return failed(staged.status());
  if (push.refill) return refill(context, of, *staged, push);
  if (all && !push.ids) staged->bytes += 8 * push.n;  // the ids that the members sent
  if (push.staged && push.moved == Moved::all) staged->bytes -= bytes_left_out(of, push);
  const std::optional<std::int64_t> previous_step = of.step;
  scene::Stepped stepped = commit(context, of, *staged, push, terms.changes ? &news.changes : nullptr);
  const StepReport& report = stepped.report;
  give_back(context, of, push, *staged);
  for (std::size_t i = inserted.id.size(); i < inserted.member.size(); ++i)
    inserted.id.push_back(*report.first_id + static_cast<particles::Id>(i));
  if (before && (report.drifted > 0 || report.moved > 0 || push.edits())) {
    const Buffer<std::uint64_t> slots = changed_slots(of, *before, terms.members);
    if (terms.changes) news.before = holders_before(context, of, *before, slots, terms.members);
    if (terms.places && !any_all) news.places = find_places(context, of, &slots);
  }
  if (terms.places && any_all) news.places = find_places(context, of, nullptr);
  if (!context.root()) return {};
  Response response = done({{"report", to_json(report)},
                            {"previous_step", previous_step ? wire::Json(*previous_step) : wire::Json(nullptr)},
                            {"plan", {{"version", of.plan_version}, {"checksum", wire::hex64(of.plan_checksum)}}}});
  if (terms.places) response.json["places"] = any_all ? "all" : "changed";
  response.arrays = member_results(of, terms, context.comm.size(), news);
  put_cuts_unless_known(context, response, of, push);  // once, for all members
  response.change = {of.name, std::move(stepped)};
  return response;
}

constexpr Command kMemberCommands[] = {{"push.members", push_members, Needs::scene}};

}  // namespace

std::span<const Command> member_commands() { return kMemberCommands; }

}  // namespace rcb::service
