// A step that the members of a parallel solver push together, each its own particles. Where they come with their ids
// rank 0 puts the shares into one order by id and pushes them as one; where they came straight to the ranks each has
// its slice. Afterwards rank 0 tells every member what concerns it.
//
// Invariant: the scene that results is the one that a single client's push of the same particles would leave.
#include <algorithm>
#include <numeric>

#include <fmt/format.h>

#include "common/plan/plan.hpp"
#include "common/wire/limits.hpp"
#include "server/service/collective.hpp"
#include "server/service/member_news.hpp"
#include "server/service/step.hpp"

namespace rcb::service {
namespace {

struct MemberRequest {
  PushRequest push;
  NewsTerms news;
};

Result<MemberRequest> read_member_push(const wire::Json& request, int ranks) {
  auto push = read_push(request, ranks);
  if (!push.ok()) return push.status();
  const auto members = wire::integer_field(request, "members", 1, wire::kSessionsMax);
  if (!members.ok()) return members.status();
  const auto follow = wire::bool_field_or(request, "follow", false);
  if (!follow.ok()) return follow.status();
  const auto places = wire::bool_field_or(request, "places", false);
  if (!places.ok()) return places.status();
  if (push->staged) push->members = static_cast<int>(*members);
  const auto unmoved = wire::numbers_field_or_empty(request, "unmoved", static_cast<std::size_t>(*members));
  if (!unmoved.ok()) return unmoved.status();
  push->unmoved.assign(static_cast<std::size_t>(*members), false);
  for (const double k : *unmoved) {
    if (!(k >= 0 && k < static_cast<double>(*members)))
      return Status(Code::invalid_argument, fmt::format("field 'unmoved': there is no member {}", k));
    push->unmoved[static_cast<std::size_t>(k)] = true;
  }
  if (!unmoved->empty() && push->weights)
    return Status(Code::invalid_argument, "weights are replaced all together", "push all particles with their weights");
  const bool changes = push->changes;
  return MemberRequest{std::move(*push), {static_cast<int>(*members), changes, *follow, *follow && *places}};
}

std::span<const particles::Id> ids_of(const PushSlice& slice) {
  return {reinterpret_cast<const particles::Id*>(slice.arrays.back().bytes.data()), slice.count};
}

Status check_shares(const std::vector<PushSlice>& slices, const Scene& scene, const MemberRequest& request) {
  const std::size_t arrays = static_cast<std::size_t>(scene.options.dims) + (request.push.weights ? 1U : 0U) + 1U;
  std::vector<bool> seen(static_cast<std::size_t>(request.news.members), false);
  std::uint64_t count = 0;
  for (const PushSlice& slice : slices) {
    if (slice.rank < 0 || slice.rank >= request.news.members || seen[static_cast<std::size_t>(slice.rank)])
      return {Code::invalid_argument, fmt::format("two shares of member {}, or no such member", slice.rank)};
    seen[static_cast<std::size_t>(slice.rank)] = true;
    bool fits = slice.arrays.size() == arrays && slice.arrays.back().name == "id";
    for (const wire::Array& array : slice.arrays) fits = fits && array.bytes.size() == slice.count * 8;
    if (!fits)
      return {Code::invalid_argument,
              fmt::format("the share of member {} must have x (y, z), w where weights are pushed, and id", slice.rank)};
    count += slice.count;
  }
  if (count == request.push.n) return {};
  return {Code::invalid_argument, fmt::format("the shares have {} particles, {} are announced", count, request.push.n)};
}

// Which of these is the k-th in ascending id. Where they are 0..n-1 in some order nothing is compared.
Buffer<std::uint64_t> ascending(const Buffer<particles::Id>& ids) {
  constexpr std::uint64_t kNone = ~std::uint64_t{0};
  const auto n = static_cast<std::uint64_t>(ids.size());
  Buffer<std::uint64_t> order(n);
  std::fill(order.begin(), order.end(), kNone);
  for (std::uint64_t k = 0; k < n; ++k) {
    const auto place = static_cast<std::uint64_t>(ids[k]);
    if (place >= n || order[place] != kNone) return order_by_id(ids);
    order[place] = k;
  }
  return order;
}

// The shares become one slice in ascending id, and `joined` says whose each particle was.
Status join_shares(std::vector<PushSlice>& slices, std::uint64_t n, Whereabouts& joined) {
  std::sort(slices.begin(), slices.end(), [](const PushSlice& a, const PushSlice& b) { return a.rank < b.rank; });
  Buffer<particles::Id> ids;
  Buffer<std::int32_t> members;
  if (!ids.try_reserve(n) || !members.try_reserve(n) || !joined.id.try_reserve(n) || !joined.member.try_reserve(n))
    return {Code::too_large, fmt::format("no memory for {} particles", n)};
  for (const PushSlice& slice : slices) {
    ids.append(ids_of(slice));
    for (std::uint64_t i = 0; i < slice.count; ++i) members.push_back(slice.rank);
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
  PushSlice whole{0, n, {}};
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

// The pushed ids are the scene's, no more and no fewer. scene_ids: ascending; empty where they are 0..n-1.
Status check_ids(const Scene& scene, const Whereabouts& joined, const Buffer<particles::Id>& scene_ids) {
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

// Afterwards context.slices is what a client that pushes everything by id would have sent, and `push` says so.
// Collective. Errors: what the shares have wrong, on every rank.
Status merge(Context& context, const Scene& scene, MemberRequest& request, Whereabouts& joined) {
  Buffer<particles::Id> scene_ids;
  if (scene.pushed && scene.ids) {
    scene_ids = gather_values<particles::Id>(context.comm, scene.particles.id.span());
    std::sort(scene_ids.begin(), scene_ids.end());
  }
  Status status;
  std::uint64_t own_ids = 0;
  if (context.root()) {
    status = check_shares(context.slices, scene, request);
    if (status.ok()) status = join_shares(context.slices, request.push.n, joined);
    if (status.ok() && scene.pushed) status = check_ids(scene, joined, scene_ids);
    if (status.ok() && !scene.pushed)
      for (std::uint64_t k = 0; k < joined.id.size(); ++k)
        own_ids |= static_cast<std::uint64_t>(joined.id[k] != static_cast<particles::Id>(k));
  }
  if (Status all = agree_status(context.comm, status); !all.ok()) return all;
  context.comm.all_max({&own_ids, 1});
  request.push.by_id = true;
  request.push.ids = own_ids != 0;
  if (context.root() && !request.push.ids)
    for (PushSlice& slice : context.slices) slice.arrays.pop_back();
  return {};
}

// Of what members did not bring, since it has not moved.
std::uint64_t bytes_left_out(const Scene& scene, const PushRequest& push) {
  std::uint64_t particles = 0;
  for (int p = 0; p < scene.options.parts; ++p)
    if (push.unmoved[static_cast<std::size_t>(plan::rank_of_part(p, scene.options.parts, push.members))])
      particles += scene.loads.counts[static_cast<std::size_t>(p)];
  return particles * static_cast<std::uint64_t>(scene.options.dims) * sizeof(double);
}

Response push_members(Context& context, const wire::Json& request) {
  const auto scene = find_scene(context, request);
  if (!scene.ok()) return failed(scene.status());
  auto members = read_member_push(request, context.comm.size());
  if (!members.ok()) return failed(members.status());
  Scene& of = *scene.value();
  PushRequest& push = members->push;
  const double start = context.clock.seconds();
  Whereabouts known;
  std::optional<PlacesBefore> before;
  if (push.staged) {
    before.emplace(of);
  } else if (Status merged = merge(context, of, *members, known); !merged.ok()) {
    return failed(merged);
  }
  context.received_seconds += context.clock.seconds() - start;
  auto staged = prepare(context, of, push);
  if (!staged.ok()) return failed(staged.status());
  if (!push.staged && !push.ids) staged->bytes += 8 * push.n;  // ids came all the same
  if (push.staged && push.what.moved == Moved::all) staged->bytes -= bytes_left_out(of, push);
  PartChanges changes;
  const std::optional<std::int64_t> previous_step = of.step;
  const StepReport report = commit(context, of, *staged, push, push.changes ? &changes : nullptr);
  give_back(context, of, push, *staged);
  if (push.staged && (report.drifted > 0 || report.moved > 0))
    known = find_changed(context, of, *before, members->news.members);
  else if (!push.staged && members->news.follow)
    find_all(context, of, members->news.places, known);
  if (!context.root()) return {};
  Response response = done({{"report", to_json(report)},
                            {"previous_step", previous_step ? wire::Json(*previous_step) : wire::Json(nullptr)},
                            {"plan", {{"version", of.plan_version}, {"checksum", wire::hex64(of.plan_checksum)}}}});
  response.arrays = member_news(of, members->news, context.comm.size(), known, changes);
  return response;
}

constexpr Command kCommands[] = {{"push.members", push_members}};

}  // namespace

std::span<const Command> member_commands() { return kCommands; }

}  // namespace rcb::service
