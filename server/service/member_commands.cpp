// A step that the members of a parallel solver push together, each its own particles with their ids. Rank 0 puts the
// shares into one order by id and pushes them as one; afterwards it tells every member what concerns it.
//
// Invariants
// 1. The scene that results is the one that a single client's push of the same particles would leave.
// 2. Who has which particle is read from each push alone: the service remembers nothing of it.
#include <algorithm>
#include <numeric>

#include <fmt/format.h>

#include "common/plan/plan.hpp"
#include "common/wire/limits.hpp"
#include "server/service/collective.hpp"
#include "server/service/step.hpp"

namespace rcb::service {
namespace {

struct MemberRequest {
  PushRequest push;
  int members = 1;
  bool follow = false;
};

Result<MemberRequest> read_member_push(const wire::Json& request, int ranks) {
  auto push = read_push(request, ranks);
  if (!push.ok()) return push.status();
  const auto members = wire::integer_field(request, "members", 1, wire::kSessionsMax);
  if (!members.ok()) return members.status();
  const auto follow = wire::bool_field_or(request, "follow", false);
  if (!follow.ok()) return follow.status();
  return MemberRequest{std::move(*push), static_cast<int>(*members), *follow};
}

// All members' particles in ascending id. On rank 0 alone.
struct Joined {
  Buffer<particles::Id> id;
  Buffer<std::int32_t> member;
};

std::span<const particles::Id> ids_of(const PushSlice& slice) {
  return {reinterpret_cast<const particles::Id*>(slice.arrays.back().bytes.data()), slice.count};
}

Status check_shares(const std::vector<PushSlice>& slices, const Scene& scene, const MemberRequest& request) {
  const std::size_t arrays = static_cast<std::size_t>(scene.options.dims) + (request.push.weights ? 1U : 0U) + 1U;
  std::vector<bool> seen(static_cast<std::size_t>(request.members), false);
  std::uint64_t count = 0;
  for (const PushSlice& slice : slices) {
    if (slice.rank < 0 || slice.rank >= request.members || seen[static_cast<std::size_t>(slice.rank)])
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
Status join_shares(std::vector<PushSlice>& slices, std::uint64_t n, Joined& joined) {
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
Status check_ids(const Scene& scene, const Joined& joined, const Buffer<particles::Id>& scene_ids) {
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
Status merge(Context& context, const Scene& scene, MemberRequest& request, Joined& joined) {
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

// The part of every particle in ascending id. On rank 0 alone. Collective.
Buffer<std::int32_t> parts_by_id(Context& context, const Scene& scene) {
  const auto ids = gather_values<particles::Id>(context.comm, scene.particles.id.span());
  const auto parts = gather_values<std::int32_t>(context.comm, scene.part.span());
  Buffer<std::int32_t> sorted(parts.size());
  if (!context.root()) return sorted;
  if (!scene.ids) {  // ids are places
    for (std::size_t k = 0; k < ids.size(); ++k) sorted[static_cast<std::size_t>(ids[k])] = parts[k];
    return sorted;
  }
  const Buffer<std::uint64_t> order = order_by_id(ids);
  for (std::size_t k = 0; k < order.size(); ++k) sorted[k] = parts[order[k]];
  return sorted;
}

template <typename T>
void add_array(std::vector<wire::Array>& to, const char* name, const char* dtype, Buffer<T>& values) {
  const std::uint64_t count = values.size();
  to.push_back(make_array(name, dtype, count, values.template release_as<std::byte>()));
}

// What one member is told, each list in ascending id.
struct MemberNews {
  Buffer<particles::Id> changed_id, leave_id, enter_id;
  Buffer<std::int32_t> changed_part, leave_to, enter_from, enter_part;
};

// For each member in turn: changed_id, changed_part, where changes were asked for; leave_id, leave_to, enter_id,
// enter_from, enter_part with follow. parts: by ascending id, with follow.
std::vector<wire::Array> news(const Scene& scene, const MemberRequest& request, const Joined& joined,
                              const PartChanges& changes, const Buffer<std::int32_t>& parts) {
  std::vector<MemberNews> of(static_cast<std::size_t>(request.members));
  std::size_t place = 0;
  for (std::size_t k = 0; k < changes.id.size(); ++k) {
    while (joined.id[place] != changes.id[k]) ++place;
    MemberNews& mine = of[static_cast<std::size_t>(joined.member[place])];
    mine.changed_id.push_back(changes.id[k]);
    mine.changed_part.push_back(changes.part[k]);
  }
  for (std::size_t k = 0; k < parts.size(); ++k) {
    const int from = joined.member[k];
    const int to = plan::rank_of_part(parts[k], scene.options.parts, request.members);
    if (from == to) continue;
    MemberNews& loser = of[static_cast<std::size_t>(from)];
    loser.leave_id.push_back(joined.id[k]);
    loser.leave_to.push_back(to);
    MemberNews& winner = of[static_cast<std::size_t>(to)];
    winner.enter_id.push_back(joined.id[k]);
    winner.enter_from.push_back(from);
    winner.enter_part.push_back(parts[k]);
  }
  std::vector<wire::Array> arrays;
  for (MemberNews& mine : of) {
    if (request.push.changes) {
      add_array(arrays, "changed_id", "<i8", mine.changed_id);
      add_array(arrays, "changed_part", "<i4", mine.changed_part);
    }
    if (request.follow) {
      add_array(arrays, "leave_id", "<i8", mine.leave_id);
      add_array(arrays, "leave_to", "<i4", mine.leave_to);
      add_array(arrays, "enter_id", "<i8", mine.enter_id);
      add_array(arrays, "enter_from", "<i4", mine.enter_from);
      add_array(arrays, "enter_part", "<i4", mine.enter_part);
    }
  }
  return arrays;
}

Response push_members(Context& context, const wire::Json& request) {
  const auto scene = find_scene(context, request);
  if (!scene.ok()) return failed(scene.status());
  auto members = read_member_push(request, context.comm.size());
  if (!members.ok()) return failed(members.status());
  const double start = context.clock.seconds();
  Joined joined;
  if (Status merged = merge(context, *scene.value(), *members, joined); !merged.ok()) return failed(merged);
  context.received_seconds += context.clock.seconds() - start;
  auto staged = prepare(context, *scene.value(), members->push);
  if (!staged.ok()) return failed(staged.status());
  if (!members->push.ids) staged->bytes += 8 * members->push.n;  // ids came all the same
  PartChanges changes;
  const std::optional<std::int64_t> previous_step = scene.value()->step;
  const StepReport report =
      commit(context, *scene.value(), *staged, members->push, members->push.changes ? &changes : nullptr);
  context.spares.push_back({scene.value()->name, {}});
  Buffer<std::int32_t> parts;
  if (members->follow) parts = parts_by_id(context, *scene.value());
  if (!context.root()) return {};
  Response response = done(
      {{"report", to_json(report)},
       {"previous_step", previous_step ? wire::Json(*previous_step) : wire::Json(nullptr)},
       {"plan", {{"version", scene.value()->plan_version}, {"checksum", wire::hex64(scene.value()->plan_checksum)}}}});
  response.arrays = news(*scene.value(), *members, joined, changes, parts);
  return response;
}

constexpr Command kCommands[] = {{"push.members", push_members}};

}  // namespace

std::span<const Command> member_commands() { return kCommands; }

}  // namespace rcb::service
