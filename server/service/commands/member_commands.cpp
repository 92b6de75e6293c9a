// A step that the members of a parallel solver push together, each its own particles. If they push with ids, rank 0
// merges the members' contributions by id into a single push; if they push straight to the ranks, each rank has its
// slice. Afterwards rank 0 tells every member its results.
//
// Invariant: the resulting scene is the same as after a single client's push of the same particles.
#include <algorithm>
#include <numeric>

#include <fmt/format.h>

#include "common/layout/layout.hpp"
#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"
#include "server/service/context/collective.hpp"
#include "server/service/step/member_results.hpp"
#include "server/service/step/step.hpp"

namespace rcb::service {
namespace {

struct MemberRequest {
  PushRequest push;
  ResultTerms message;
};

Result<MemberRequest> read_member_push(const wire::Json& request, int ranks) {
  auto push = read_order(request, ranks);
  if (!push.ok()) return push.status();
  wire::FieldReader fields(request);
  const std::int64_t members = fields.integer("members", 1, wire::kSessionsMax);
  const bool follow = fields.flag("follow");
  const bool places = fields.flag("places");
  const std::vector<double> unmoved = fields.numbers("unmoved", static_cast<std::size_t>(members));
  if (!fields.ok()) return fields.status();
  if (push->staged) {
    const wire::Json& staged = request.at("staged");
    const bool all_share = std::all_of(staged.begin(), staged.end(), [](const auto& one) { return one.is_object(); });
    push->members = static_cast<int>(members);
    push->way = all_share ? api::Way::shared_memory : api::Way::sockets;
  }
  push->unmoved.assign(static_cast<std::size_t>(members), false);
  for (const double k : unmoved) {
    if (!(k >= 0 && k < static_cast<double>(members)))
      return Status(Code::invalid_argument, fmt::format("field 'unmoved': there is no member {}", k));
    push->unmoved[static_cast<std::size_t>(k)] = true;
  }
  if (!unmoved.empty() && push->weights)
    return Status(Code::invalid_argument, "weights are replaced all together", "push all particles with their weights");
  const bool changes = push->changes;
  return MemberRequest{std::move(*push), {static_cast<int>(members), changes, follow, follow && places}};
}

std::span<const particles::Id> ids_of(const PushSlice& slice) {
  return {reinterpret_cast<const particles::Id*>(slice.arrays.back().bytes.data()), slice.count};
}

Status check_shares(const std::vector<PushSlice>& slices, const Scene& scene, const MemberRequest& request) {
  const std::size_t arrays = static_cast<std::size_t>(scene.options.dims) + (request.push.weights ? 1U : 0U) + 1U;
  std::vector<bool> seen(static_cast<std::size_t>(request.message.members), false);
  std::uint64_t count = 0;
  for (const PushSlice& slice : slices) {
    if (slice.rank < 0 || slice.rank >= request.message.members || seen[static_cast<std::size_t>(slice.rank)])
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

// The k-th entry is the index of the particle with the k-th smallest id. No sorting if the ids are 0..n-1 in any order.
Buffer<std::uint64_t> ascending(const Buffer<particles::Id>& ids) {
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

// Merges the contributions into one slice in ascending id; `joined` gets each particle's id and member.
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

// Makes context.slices and `push` what they would be if a single client had pushed everything by id. Collective.
// Errors: faults of the contributions, the same on every rank.
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

// Bytes of the positions that unmoved members did not send.
std::uint64_t bytes_left_out(const Scene& scene, const PushRequest& push) {
  std::uint64_t particles = 0;
  for (int p = 0; p < scene.options.parts; ++p)
    if (push.unmoved[static_cast<std::size_t>(layout::rank_of_part(p, scene.options.parts, push.members))])
      particles += scene.loads.counts[static_cast<std::size_t>(p)];
  return particles * static_cast<std::uint64_t>(scene.options.dims) * sizeof(double);
}

Response push_members(Context& context, Scene& of, const wire::Json& request) {
  auto members = read_member_push(request, context.comm.size());
  if (!members.ok()) return failed(members.status());
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
  if (!push.staged && !push.ids) staged->bytes += 8 * push.n;  // the ids that the members sent
  if (push.staged && push.moved == Moved::all) staged->bytes -= bytes_left_out(of, push);
  PartChanges changes;
  const std::optional<std::int64_t> previous_step = of.step;
  const StepReport report = commit(context, of, *staged, push, push.changes ? &changes : nullptr);
  give_back(context, of, push, *staged);
  if (push.staged && (report.drifted > 0 || report.moved > 0))
    known = find_changed(context, of, *before, members->message.members);
  else if (!push.staged && members->message.follow)
    find_all(context, of, members->message.places, known);
  if (!context.root()) return {};
  Response response = done({{"report", to_json(report)},
                            {"previous_step", previous_step ? wire::Json(*previous_step) : wire::Json(nullptr)},
                            {"plan", {{"version", of.plan_version}, {"checksum", wire::hex64(of.plan_checksum)}}}});
  response.arrays = member_results(of, members->message, context.comm.size(), known, changes);
  return response;
}

constexpr Command kMemberCommands[] = {{"push.members", push_members, Needs::scene}};

}  // namespace

std::span<const Command> member_commands() { return kMemberCommands; }

}  // namespace rcb::service
