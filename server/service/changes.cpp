#include "server/service/changes.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include <fmt/format.h>

#include "common/plan/plan.hpp"
#include "common/wire/limits.hpp"
#include "server/service/collective.hpp"

namespace rcb::service {
namespace {

constexpr std::uint64_t kNone = std::numeric_limits<std::uint64_t>::max();
constexpr const char* kAxisNames[] = {"x", "y", "z"};

using Expected = std::vector<std::pair<std::string, std::string>>;  // name, dtype

Expected axes_of(const Scene& scene) {
  Expected arrays;
  for (int a = 0; a < scene.options.dims; ++a) arrays.emplace_back(kAxisNames[a], "<f8");
  return arrays;
}

Status check_arrays(const PushSlice& slice, const std::string& what, std::uint64_t count, const Expected& expected) {
  bool match = slice.count == count && slice.arrays.size() == expected.size();
  for (std::size_t a = 0; match && a < expected.size(); ++a) {
    const wire::Array& array = slice.arrays[a];
    match = array.name == expected[a].first && array.dtype == expected[a].second &&
            array.shape == std::vector<std::uint64_t>{count} && array.bytes.size() == count * 8;
  }
  if (match) return {};
  std::string names;
  for (const auto& [name, dtype] : expected) names += fmt::format("{}{} {}", names.empty() ? "" : ", ", name, dtype);
  return {Code::invalid_argument, fmt::format("the {} must be {} particles with the arrays {}", what, count, names)};
}

// The slice of that "rank", taken out; none: an empty one.
PushSlice take_slice(std::vector<PushSlice>& slices, int rank) {
  const auto found = std::find_if(slices.begin(), slices.end(), [rank](const auto& s) { return s.rank == rank; });
  PushSlice slice;
  if (found == slices.end()) return slice;
  slice = std::move(*found);
  slices.erase(found);
  return slice;
}

// Rank 0's array on all ranks. Collective.
template <typename T>
void share(partition::Comm& comm, PushSlice& slice, std::size_t array, std::uint64_t count, Buffer<T>& out) {
  if (comm.rank() == 0 && count > 0) out = slice.arrays[array].bytes.release_as<T>();
  out.resize(count);
  if (count > 0) comm.broadcast(std::as_writable_bytes(out.span()), 0);
}

const IdIndex& index_of(Scene& scene) {
  IdIndex& index = scene.index;
  if (index.plan_version == scene.plan_version) return index;
  index.slot.clear();
  index.slot.reserve(scene.particles.count());
  for (std::size_t i = 0; i < scene.particles.count(); ++i) index.slot.emplace(scene.particles.id[i], i);
  index.plan_version = scene.plan_version;
  return index;
}

// Collective at a scene's first insertion or removal.
std::uint64_t id_next(partition::Comm& comm, Scene& scene) {
  if (scene.id_next) return *scene.id_next;
  std::uint64_t next = scene.n;
  if (scene.ids) {
    next = 0;
    for (const particles::Id id : scene.particles.id) next = std::max(next, static_cast<std::uint64_t>(id) + 1);
    comm.all_max({&next, 1});
  }
  scene.id_next = next;
  return next;
}

std::optional<particles::Id> twin_of(const Buffer<particles::Id>& ids) {
  Buffer<particles::Id> sorted = ids;
  std::sort(sorted.begin(), sorted.end());
  const auto* twin = std::adjacent_find(sorted.begin(), sorted.end());
  if (twin == sorted.end()) return std::nullopt;
  return *twin;
}

Status not_held(particles::Id id, const char* doing) {
  return {Code::not_found, fmt::format("particle {} is to be {}, and the scene has none of that id", id, doing),
          "the previous step stands"};
}

// Which of the ids this rank holds: (place among them, slot). The ids are distinct. Errors: not_found, naming the
// first that no rank holds. Collective.
Status find_held(partition::Comm& comm, Scene& scene, std::span<const particles::Id> ids, const char* doing,
                 std::vector<std::pair<std::uint64_t, std::uint64_t>>& held) {
  const IdIndex& index = index_of(scene);
  for (std::size_t k = 0; k < ids.size(); ++k)
    if (const auto found = index.slot.find(ids[k]); found != index.slot.end()) held.emplace_back(k, found->second);
  std::uint64_t count = held.size();
  comm.all_sum({&count, 1});
  if (count == ids.size()) return {};
  std::vector<std::uint64_t> seen(ids.size(), 0);
  for (const auto& [k, slot] : held) seen[k] = 1;
  comm.all_sum(seen);
  const auto missing = std::find(seen.begin(), seen.end(), std::uint64_t{0});
  return not_held(ids[static_cast<std::size_t>(missing - seen.begin())], doing);
}

// The inserted, the same on all ranks.
struct Inserted {
  particles::ParticleSet set;
  Buffer<particles::Id> removed;
};

Status check_inserted(const Inserted& in, bool own_ids) {
  const particles::ParticleView view = in.set.view();
  for (std::size_t i = 0; i < view.count; ++i) {
    for (std::size_t a = 0; a < static_cast<std::size_t>(view.dims); ++a)
      if (!std::isfinite(view.position[a][i]))
        return {Code::not_finite,
                fmt::format("inserted particle {} (index, from 0): {} is {}", i, kAxisNames[a], view.position[a][i]),
                "positions must be finite; the previous step stands"};
    if (view.weight != nullptr && !(view.weight[i] >= 0 && std::isfinite(view.weight[i])))
      return {Code::invalid_argument,
              fmt::format("inserted particle {} (index, from 0): weight is {}", i, view.weight[i]),
              "weights must be finite and >= 0; the previous step stands"};
    if (own_ids && view.id[i] < 0)
      return {Code::invalid_argument, fmt::format("inserted particle {} (index, from 0): id is {}", i, view.id[i]),
              "ids are >= 0; the previous step stands"};
  }
  if (own_ids)
    if (const auto twin = twin_of(in.set.id))
      return {Code::invalid_argument, fmt::format("id {} is inserted more than once", *twin), "ids must be distinct"};
  if (const auto twin = twin_of(in.removed))
    return {Code::invalid_argument, fmt::format("id {} is removed more than once", *twin), "ids must be distinct"};
  return {};
}

// Ids for the inserted; `edits` learns what the scene's ids are then. Collective.
Status settle_ids(partition::Comm& comm, Scene& scene, const PushChanges& changes, Inserted& in, Edits& edits) {
  const std::uint64_t next = id_next(comm, scene);
  constexpr std::uint64_t kEnd = std::uint64_t{1} << 63U;
  Buffer<particles::Id>& ids = in.set.id;
  edits.id_next = next;
  if (!changes.own_ids && changes.inserted > 0) {
    if (next > kEnd - changes.inserted)
      return {Code::invalid_argument, "no ids are left above the greatest ever used", "choose the ids yourself"};
    for (std::uint64_t i = 0; i < changes.inserted; ++i) ids[i] = static_cast<particles::Id>(next + i);
    edits.first_id = static_cast<std::int64_t>(next);
  }
  bool follow = !scene.ids && changes.removed == 0;
  for (std::uint64_t i = 0; i < changes.inserted; ++i) {
    follow = follow && static_cast<std::uint64_t>(ids[i]) == scene.n + i;
    edits.id_next = std::max(edits.id_next, static_cast<std::uint64_t>(ids[i]) + 1);
  }
  edits.ids = !follow;
  if (!changes.own_ids) return {};
  std::uint64_t taken = kNone;
  const IdIndex& index = index_of(scene);
  for (const particles::Id id : ids)
    if (index.slot.contains(id)) taken = std::min(taken, static_cast<std::uint64_t>(id));
  comm.all_min({&taken, 1});
  if (taken == kNone) return {};
  return {Code::already_exists, fmt::format("particle {} is to be inserted, and the scene has it", taken),
          "the previous step stands; an id may be used again after the step that removes it"};
}

template <typename T>
bool make_room(Buffer<T>& buffer, std::uint64_t count) {
  return count <= buffer.capacity() || buffer.try_reserve(count + count / 16);
}

// Memory that the commit needs, so that it can't fail.
Status reserve_arrivals(Scene& scene, std::uint64_t arriving, int rank) {
  const std::uint64_t count = scene.particles.count() + arriving;
  bool fits = make_room(scene.part, count) && make_room(scene.particles.id, count);
  for (std::size_t a = 0; a < static_cast<std::size_t>(scene.options.dims); ++a)
    fits = fits && make_room(scene.particles.position[a], count);
  if (scene.particles.has_weights) fits = fits && make_room(scene.particles.weight, count);
  if (fits) return {};
  return {Code::too_large, fmt::format("rank {} has no memory for {} more particles", rank, arriving)};
}

// The inserted that this rank's parts own, in ascending id. Local.
void choose_arriving(const partition::Comm& comm, const Scene& scene, const Inserted& in, Edits& edits) {
  const std::int64_t begin = plan::part_begin(comm.rank(), scene.options.parts, comm.size());
  const std::int64_t end = plan::part_begin(comm.rank() + 1, scene.options.parts, comm.size());
  std::vector<std::size_t> chosen;
  for (std::size_t i = 0; i < edits.inserted; ++i)
    if (edits.inserted_part[i] >= begin && edits.inserted_part[i] < end) chosen.push_back(i);
  std::sort(chosen.begin(), chosen.end(), [&](std::size_t a, std::size_t b) { return in.set.id[a] < in.set.id[b]; });
  particles::ParticleSet& out = edits.arriving;
  out.dims = scene.options.dims;
  out.has_weights = scene.particles.has_weights;
  for (const std::size_t i : chosen) {
    for (std::size_t a = 0; a < static_cast<std::size_t>(out.dims); ++a)
      out.position[a].push_back(in.set.position[a][i]);
    out.id.push_back(in.set.id[i]);
    if (out.has_weights) out.weight.push_back(in.set.weight[i]);
    edits.arriving_part.push_back(edits.inserted_part[i]);
  }
}

// All removed particles' parts on every rank. Collective.
void share_removed_parts(partition::Comm& comm, const Scene& scene, Edits& edits) {
  std::vector<std::int32_t> mine;
  for (const std::uint64_t slot : edits.removed_slots) mine.push_back(scene.part[slot]);
  std::vector<std::byte> all;
  std::vector<std::size_t> sizes;
  comm.all_gather(std::as_bytes(std::span(mine)), all, sizes);
  edits.removed_parts.resize(all.size() / sizeof(std::int32_t));
  if (!all.empty()) std::memcpy(edits.removed_parts.data(), all.data(), all.size());
}

// The two slices on all ranks. Collective.
Status share_slices(Context& context, const Scene& scene, const PushChanges& changes, Inserted& in) {
  PushSlice inserted = take_slice(context.slices, wire::kInsertedSlice);
  PushSlice removed = take_slice(context.slices, wire::kRemovedSlice);
  Expected arrays = axes_of(scene);
  if (scene.particles.has_weights) arrays.emplace_back("w", "<f8");
  if (changes.own_ids) arrays.emplace_back("id", "<i8");
  Status good;
  if (context.root() && changes.inserted > 0) good = check_arrays(inserted, "inserted", changes.inserted, arrays);
  if (context.root() && changes.removed > 0 && good.ok())
    good = check_arrays(removed, "removed", changes.removed, {{"id", "<i8"}});
  if (Status status = agree_status(context.comm, good); !status.ok()) return status;
  partition::Comm& comm = context.comm;
  in.set.dims = scene.options.dims;
  in.set.has_weights = scene.particles.has_weights;
  std::size_t a = 0;
  for (; a < static_cast<std::size_t>(scene.options.dims); ++a)
    share(comm, inserted, a, changes.inserted, in.set.position[a]);
  if (in.set.has_weights) share(comm, inserted, a++, changes.inserted, in.set.weight);
  if (changes.own_ids)
    share(comm, inserted, a, changes.inserted, in.set.id);
  else
    in.set.id.resize(changes.inserted);
  share(comm, removed, 0, changes.removed, in.removed);
  return {};
}

Result<std::uint64_t> count_field(const wire::Json& request, const char* name) {
  const auto value = wire::integer_field_or(request, name, 0, wire::kParticlesMax, 0);
  if (!value.ok()) return value.status();
  return static_cast<std::uint64_t>(*value);
}

// Ascending, and of this rank.
Status check_slots(const Buffer<std::uint64_t>& slots, std::uint64_t held, int rank) {
  for (std::size_t k = 0; k < slots.size(); ++k) {
    if (slots[k] >= held)
      return {Code::invalid_argument, fmt::format("slot {} of rank {}, which holds {}", slots[k], rank, held)};
    if (k > 0 && slots[k] <= slots[k - 1])
      return {Code::invalid_argument,
              fmt::format("slice of rank {}: slot {} follows slot {}", rank, slots[k], slots[k - 1]),
              "slots are ascending, each once"};
  }
  return {};
}

// Order "id": rank 0's one slice to all ranks; each keeps what it holds. Collective.
Status receive_by_id(Context& context, Scene& scene, std::uint64_t count, particles::ParticleSet& arrays,
                     Subset& subset) {
  partition::Comm& comm = context.comm;
  PushSlice slice = take_slice(context.slices, 0);
  Expected expected = axes_of(scene);
  expected.emplace_back("id", "<i8");
  Status good;
  if (context.root() && (count > 0 || !slice.arrays.empty())) good = check_arrays(slice, "moved", count, expected);
  if (Status status = agree_status(comm, good); !status.ok()) return status;
  particles::ParticleSet all;
  all.dims = scene.options.dims;
  for (std::size_t a = 0; a < static_cast<std::size_t>(all.dims); ++a) share(comm, slice, a, count, all.position[a]);
  share(comm, slice, static_cast<std::size_t>(all.dims), count, all.id);
  for (std::size_t k = 1; k < count; ++k)
    if (all.id[k] <= all.id[k - 1])
      return {Code::invalid_argument, fmt::format("id {} follows id {}", all.id[k], all.id[k - 1]),
              "in order \"id\" moved particles come in ascending id, each once"};
  std::vector<std::pair<std::uint64_t, std::uint64_t>> held;
  if (Status status = find_held(comm, scene, all.id.span(), "moved", held); !status.ok()) return status;
  std::sort(held.begin(), held.end(), [](const auto& a, const auto& b) { return a.second < b.second; });
  for (const auto& [k, slot] : held) {
    for (std::size_t a = 0; a < static_cast<std::size_t>(all.dims); ++a)
      arrays.position[a].push_back(all.position[a][k]);
    arrays.id.push_back(all.id[k]);
    subset.slot.push_back(slot);
  }
  return {};
}

// Order "plan" by the gateway: each rank's slice from rank 0 to it. Collective.
Status scatter_slices(Context& context, const Scene& scene, const PushChanges& changes, PushSlice& mine) {
  partition::Comm& comm = context.comm;
  Expected expected = axes_of(scene);
  expected.emplace_back("slot", "<u8");
  const auto ranks = static_cast<std::size_t>(comm.size());
  std::vector<PushSlice> slices(ranks);
  Status good;
  if (context.root()) {
    for (std::size_t r = 0; r < ranks; ++r) {
      slices[r] = take_slice(context.slices, static_cast<int>(r));
      if (good.ok() && (changes.counts[r] > 0 || !slices[r].arrays.empty()))
        good = check_arrays(slices[r], fmt::format("moved of rank {}", r), changes.counts[r], expected);
    }
    if (good.ok() && !context.slices.empty())
      good = {Code::invalid_argument, fmt::format("a second slice for rank {}", context.slices.front().rank)};
  }
  if (Status status = agree_status(comm, good); !status.ok()) return status;
  mine.rank = comm.rank();
  mine.count = changes.counts[static_cast<std::size_t>(comm.rank())];
  for (std::size_t a = 0; a < expected.size(); ++a) {
    std::vector<std::span<const std::byte>> pieces;
    if (context.root())
      for (const PushSlice& slice : slices)
        pieces.push_back(slice.arrays.empty() ? std::span<const std::byte>() : slice.arrays[a].bytes.span());
    wire::Array array{expected[a].first, expected[a].second, {mine.count}, Buffer<std::byte>(8 * mine.count)};
    comm.scatter(pieces, 0, array.bytes.span());
    mine.arrays.push_back(std::move(array));
  }
  return {};
}

}  // namespace

std::uint64_t PushChanges::moving(std::uint64_t n) const {
  if (moved == Moved::all) return n;
  std::uint64_t sum = 0;
  if (moved == Moved::some)
    for (const std::uint64_t count : counts) sum += count;
  return sum;
}

Result<PushChanges> read_changes(const wire::Json& request, bool by_id, int ranks) {
  PushChanges changes;
  const auto moved = request.contains("moved") ? wire::string_field(request, "moved", 16) : std::string("all");
  if (!moved.ok()) return moved.status();
  if (*moved != "all" && *moved != "some" && *moved != "none")
    return Status(Code::invalid_argument, fmt::format("moved '{}'", *moved), "use 'all', 'some' or 'none'");
  changes.moved = *moved == "all" ? Moved::all : *moved == "some" ? Moved::some : Moved::none;
  const auto dtype = request.contains("dtype") ? wire::string_field(request, "dtype", 16) : std::string("<f8");
  if (!dtype.ok()) return dtype.status();
  if (*dtype != "<f8" && *dtype != "<f4")
    return Status(Code::invalid_argument, fmt::format("dtype '{}'", *dtype), "positions are <f8 or <f4");
  changes.single = *dtype == "<f4";
  if (request.contains("base_step") && !request["base_step"].is_null()) {
    const auto base = wire::integer_field(request, "base_step", 0, wire::kStepMax);
    if (!base.ok()) return base.status();
    changes.base_step = *base;
  }
  const auto counts = wire::numbers_field_or_empty(request, "counts", static_cast<std::size_t>(ranks));
  if (!counts.ok()) return counts.status();
  if (changes.moved == Moved::some) {
    if (counts->size() != (by_id ? 1U : static_cast<std::size_t>(ranks)))
      return Status(Code::invalid_argument, "field 'counts': expected how many particles each rank's slice has",
                    "one number for each rank; in order \"id\" a single one");
    for (const double count : *counts) {
      if (!(count >= 0 && count <= static_cast<double>(wire::kParticlesMax)) || count != std::floor(count))
        return Status(Code::invalid_argument, fmt::format("field 'counts': {} isn't a number of particles", count));
      changes.counts.push_back(static_cast<std::uint64_t>(count));
    }
  }
  const auto inserted = count_field(request, "inserted");
  if (!inserted.ok()) return inserted.status();
  const auto removed = count_field(request, "removed");
  if (!removed.ok()) return removed.status();
  const auto own_ids = wire::bool_field_or(request, "inserted_ids", false);
  if (!own_ids.ok()) return own_ids.status();
  changes.inserted = *inserted;
  changes.removed = *removed;
  changes.own_ids = *own_ids && *inserted > 0;
  return changes;
}

Status check_changes(const Scene& scene, const PushChanges& changes, bool weights) {
  if (changes.moved != Moved::all && !changes.base_step)
    return {Code::invalid_argument, "a push of few particles names no 'base_step'",
            "name the step that the others' positions are those of"};
  if (changes.base_step && scene.step != changes.base_step)
    return {Code::base_lost,
            scene.step ? fmt::format("the push builds on step {}, the last step of scene '{}' is {}",
                                     *changes.base_step, scene.name, *scene.step)
                       : fmt::format("the push builds on step {}, scene '{}' has no positions yet", *changes.base_step,
                                     scene.name),
            "push all particles"};
  if (!scene.pushed && changes.edits())
    return {Code::invalid_argument,
            fmt::format("scene '{}' has no particles yet to insert others beside or to remove", scene.name),
            "push a first step with all of them"};
  if (changes.moved != Moved::all && weights)
    return {Code::invalid_argument, "weights are replaced all together", "push all particles with their weights"};
  if (changes.removed > scene.n)
    return {Code::invalid_argument,
            fmt::format("{} particles are to be removed, scene '{}' has {}", changes.removed, scene.name, scene.n)};
  if (scene.n + changes.inserted - changes.removed > static_cast<std::uint64_t>(wire::kParticlesMax))
    return {Code::too_large,
            fmt::format("scene '{}' would have more than {} particles", scene.name, wire::kParticlesMax)};
  return {};
}

Result<Edits> prepare_edits(Context& context, Scene& scene, const PushChanges& changes) {
  Edits edits;
  if (!changes.edits()) return edits;
  edits.inserted = changes.inserted;
  edits.removed = changes.removed;
  partition::Comm& comm = context.comm;
  Inserted in;
  if (Status status = share_slices(context, scene, changes, in); !status.ok()) return status;
  if (Status status = check_inserted(in, changes.own_ids); !status.ok()) return status;
  std::vector<std::pair<std::uint64_t, std::uint64_t>> held;
  if (changes.removed > 0) {
    if (Status status = find_held(comm, scene, in.removed.span(), "removed", held); !status.ok()) return status;
    for (const auto& [k, slot] : held) edits.removed_slots.push_back(slot);
    std::sort(edits.removed_slots.begin(), edits.removed_slots.end());
    share_removed_parts(comm, scene, edits);
  }
  if (Status status = settle_ids(comm, scene, changes, in, edits); !status.ok()) return status;
  edits.inserted_part.resize(changes.inserted);
  scene.tree.classify(in.set.view(), edits.inserted_part.span());
  choose_arriving(comm, scene, in, edits);
  if (Status status = agree_status(comm, reserve_arrivals(scene, edits.arriving.count(), comm.rank())); !status.ok())
    return status;
  return edits;
}

Status receive_subset(Context& context, Scene& scene, const PushChanges& changes, bool by_id, bool staged,
                      particles::ParticleSet& arrays, Subset& subset, Status& ready) {
  partition::Comm& comm = context.comm;
  if (by_id) return receive_by_id(context, scene, changes.counts.front(), arrays, subset);
  const auto dims = static_cast<std::size_t>(scene.options.dims);
  PushSlice mine;
  if (staged) {
    Expected expected = axes_of(scene);
    expected.emplace_back("slot", "<u8");
    mine = take_slice(context.slices, comm.rank());
    ready = check_arrays(mine, fmt::format("moved of rank {}", comm.rank()),
                         changes.counts[static_cast<std::size_t>(comm.rank())], expected);
  } else if (Status status = scatter_slices(context, scene, changes, mine); !status.ok()) {
    return status;
  }
  if (!ready.ok()) return {};
  for (std::size_t a = 0; a < dims; ++a) arrays.position[a] = mine.arrays[a].bytes.release_as<double>();
  subset.slot = mine.arrays[dims].bytes.release_as<std::uint64_t>();
  ready = check_slots(subset.slot, scene.particles.count(), comm.rank());
  if (!ready.ok()) return {};
  arrays.id.resize(subset.slot.size());
  for (std::size_t k = 0; k < subset.slot.size(); ++k) arrays.id[k] = scene.particles.id[subset.slot[k]];
  return {};
}

void forget_removed(const Edits& edits, Drift& drift) {
  if (edits.removed_slots.empty()) return;
  std::size_t kept = 0;
  for (std::size_t k = 0; k < drift.count(); ++k) {
    if (std::binary_search(edits.removed_slots.begin(), edits.removed_slots.end(), drift.slot[k])) continue;
    drift.slot[kept] = drift.slot[k];
    drift.part[kept++] = drift.part[k];
  }
  drift.slot.resize(kept);
  drift.part.resize(kept);
}

}  // namespace rcb::service
