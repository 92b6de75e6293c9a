#include "server/service/push/changes.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>
#include <utility>

#include <fmt/format.h>

#include "common/base/axis_names.hpp"
#include "common/layout/layout.hpp"
#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"
#include "server/service/context/collective.hpp"
#include "server/service/push/member_slices.hpp"

namespace rcb::service {
namespace {

using Expected = std::vector<std::pair<std::string, std::string>>;  // name and dtype

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

// Removes the slice of that "rank" from `slices` and returns it; an empty slice if there is none.
PushSlice take_slice(std::vector<PushSlice>& slices, int rank) {
  const auto found = std::find_if(slices.begin(), slices.end(), [rank](const auto& s) { return s.rank == rank; });
  PushSlice slice;
  if (found == slices.end()) return slice;
  slice = std::move(*found);
  slices.erase(found);
  return slice;
}

// Hands the arrays of rank 0's slice to all ranks, kPiece particles at a time: whatever its size, a rank needs memory
// for one piece and for what of it is its own.
class Pieces {
 public:
  Pieces(comm::Comm& comm, const PushSlice& slice, std::uint64_t count) : comm_(comm), slice_(slice), count_(count) {}

  bool done() const { return first_ >= count_; }
  void next() { first_ += size(); }
  std::uint64_t first() const { return first_; }
  std::size_t size() const { return static_cast<std::size_t>(std::min<std::uint64_t>(kPiece, count_ - first_)); }
  // Collective.
  template <typename T>
  void get(std::size_t array, Buffer<T>& out) {
    out.resize(size());
    if (comm_.rank() == 0)
      std::memcpy(out.data(), slice_.arrays[array].bytes.data() + first_ * sizeof(T), out.span().size_bytes());
    comm_.broadcast(std::as_writable_bytes(out.span()), 0);
  }

 private:
  static constexpr std::uint64_t kPiece = 65536;
  comm::Comm& comm_;
  const PushSlice& slice_;
  std::uint64_t count_;
  std::uint64_t first_ = 0;
};

template <typename T>
std::span<const T> values_of(const PushSlice& slice, std::size_t array) {
  if (array >= slice.arrays.size()) return {};
  const Buffer<std::byte>& bytes = slice.arrays[array].bytes;
  return {reinterpret_cast<const T*>(bytes.data()), bytes.size() / sizeof(T)};
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

// The next unused id of the scene. Collective at a scene's first insertion or removal.
std::uint64_t id_next(comm::Comm& comm, Scene& scene) {
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

std::optional<particles::Id> twin_of(std::span<const particles::Id> ids) {
  std::vector<particles::Id> sorted(ids.begin(), ids.end());
  std::sort(sorted.begin(), sorted.end());
  const auto twin = std::adjacent_find(sorted.begin(), sorted.end());
  if (twin == sorted.end()) return std::nullopt;
  return *twin;
}

Status not_held(particles::Id id, const char* doing) {
  return {Code::not_found, fmt::format("particle {} is to be {}, and the scene has none of that id", id, doing),
          "the previous step stands"};
}

// Calls found(index in the piece, slot) for each of the distinct ids in this array of the slice that this rank holds,
// after look() has fetched what else it needs of the piece. Errors: not_found, naming the first id that no rank holds.
// Collective.
template <typename Look, typename Found>
Status find_held(comm::Comm& comm, Scene& scene, const PushSlice& slice, std::size_t array, std::uint64_t count,
                 const char* doing, const Look& look, const Found& found) {
  const IdIndex& index = index_of(scene);
  Buffer<particles::Id> ids;
  std::uint64_t held = 0;
  for (Pieces pieces(comm, slice, count); !pieces.done(); pieces.next()) {
    pieces.get(array, ids);
    look(pieces);
    for (std::size_t k = 0; k < ids.size(); ++k)
      if (const auto entry = index.slot.find(ids[k]); entry != index.slot.end()) {
        found(k, ids[k], entry->second);
        ++held;
      }
  }
  comm.all_sum({&held, 1});
  if (held == count) return {};
  std::vector<std::uint64_t> seen;
  for (Pieces pieces(comm, slice, count); !pieces.done(); pieces.next()) {
    pieces.get(array, ids);
    seen.clear();
    for (const particles::Id id : ids) seen.push_back(index.slot.contains(id) ? 1 : 0);
    comm.all_sum(seen);
    const auto missing = std::find(seen.begin(), seen.end(), std::uint64_t{0});
    if (missing != seen.end()) return not_held(ids[static_cast<std::size_t>(missing - seen.begin())], doing);
  }
  return {Code::internal, "an id is held twice"};
}

// Where the values of inserted particles lie in their slice.
struct Inserted {
  PushSlice slice;  // on rank 0; dims arrays of positions, then weights and ids where there are any
  std::size_t dims = 0;
  bool has_weights = false;
  bool has_ids = false;

  std::size_t ids() const { return dims + (has_weights ? 1 : 0); }
};

// Rank 0's check of what it was sent.
Status check_inserted(const Inserted& in, const PushSlice& removed) {
  for (std::size_t a = 0; a < in.dims; ++a) {
    const auto axis = values_of<double>(in.slice, a);
    for (std::size_t i = 0; i < axis.size(); ++i)
      if (!std::isfinite(axis[i]))
        return {Code::not_finite,
                fmt::format("inserted particle {} (index, from 0): {} is {}", i, kAxisNames[a], axis[i]),
                "positions must be finite; the previous step stands"};
  }
  if (in.has_weights) {
    const auto weights = values_of<double>(in.slice, in.dims);
    for (std::size_t i = 0; i < weights.size(); ++i)
      if (!(weights[i] >= 0 && std::isfinite(weights[i])))
        return {Code::invalid_argument,
                fmt::format("inserted particle {} (index, from 0): weight is {}", i, weights[i]),
                "weights must be finite and >= 0; the previous step stands"};
  }
  if (in.has_ids) {
    const auto ids = values_of<particles::Id>(in.slice, in.ids());
    for (std::size_t i = 0; i < ids.size(); ++i)
      if (ids[i] < 0)
        return {Code::invalid_argument, fmt::format("inserted particle {} (index, from 0): id is {}", i, ids[i]),
                "ids are >= 0; the previous step stands"};
    if (const auto twin = twin_of(ids))
      return {Code::invalid_argument, fmt::format("id {} is inserted more than once", *twin), "ids must be distinct"};
  }
  if (const auto twin = twin_of(values_of<particles::Id>(removed, 0)))
    return {Code::invalid_argument, fmt::format("id {} is removed more than once", *twin), "ids must be distinct"};
  return {};
}

template <typename T>
bool make_room(Buffer<T>& buffer, std::uint64_t count) {
  return count <= buffer.capacity() || buffer.try_reserve(count + count / 16);
}

// Reserves the memory that the commit needs, so that the commit can't fail.
Status reserve_arrivals(Scene& scene, std::uint64_t arriving, int rank) {
  const std::uint64_t count = scene.particles.count() + arriving;
  bool fits = make_room(scene.part, count) && make_room(scene.particles.id, count);
  for (std::size_t a = 0; a < static_cast<std::size_t>(scene.options.dims); ++a)
    fits = fits && make_room(scene.particles.position[a], count);
  if (scene.particles.has_weights) fits = fits && make_room(scene.particles.weight, count);
  if (fits) return {};
  return {Code::too_large, fmt::format("rank {} has no memory for {} more particles", rank, arriving)};
}

// The inserted particles of this rank's parts, as they come.
class Arriving {
 public:
  Arriving(const comm::Comm& comm, const Scene& scene, Edits& edits)
      : begin_(layout::part_begin(comm.rank(), scene.options.parts, comm.size())),
        end_(layout::part_begin(comm.rank() + 1, scene.options.parts, comm.size())),
        set_(edits.arriving),
        parts_(edits.arriving_part) {
    set_.dims = scene.options.dims;
    set_.has_weights = scene.particles.has_weights;
  }

  void add(const particles::ParticleSet& piece, std::span<const std::int32_t> part) {
    std::size_t own = 0;
    for (const std::int32_t p : part) own += is_own(p) ? 1U : 0U;
    full_ = full_ || !make_room_for(own);
    if (full_ || own == 0) return;
    for (std::size_t i = 0; i < part.size(); ++i) {
      if (!is_own(part[i])) continue;
      for (std::size_t a = 0; a < dims(); ++a) set_.position[a].push_back(piece.position[a][i]);
      set_.id.push_back(piece.id[i]);
      if (set_.has_weights) set_.weight.push_back(piece.weight[i]);
      parts_.push_back(part[i]);
    }
  }

  // Puts them in ascending id. False: there was no memory for all of them.
  bool finish() {
    if (!full_) sort_by_id(set_, parts_);
    return !full_;
  }

 private:
  std::size_t dims() const { return static_cast<std::size_t>(set_.dims); }
  bool is_own(std::int32_t part) const { return part >= begin_ && part < end_; }
  bool make_room_for(std::size_t more) {
    const std::size_t count = set_.id.size() + more;
    bool fits = make_room(set_.id, count) && make_room(parts_, count);
    for (std::size_t a = 0; a < dims(); ++a) fits = fits && make_room(set_.position[a], count);
    return fits && (!set_.has_weights || make_room(set_.weight, count));
  }
  std::int64_t begin_, end_;
  particles::ParticleSet& set_;
  Buffer<std::int32_t>& parts_;
  bool full_ = false;
};

// Hands the inserted particles round: each rank keeps those of its parts, in ascending id, and counts all by part.
// Gives them their ids, or checks those they bring. Collective.
Status insert(comm::Comm& comm, Scene& scene, const Inserted& in, Edits& edits) {
  const std::uint64_t next = id_next(comm, scene);
  constexpr std::uint64_t kEnd = std::uint64_t{1} << 63U;
  edits.id_next = next;
  if (!in.has_ids && edits.inserted > 0) {
    if (next > kEnd - edits.inserted)
      return {Code::invalid_argument, "no ids are left above the greatest ever used", "choose the ids yourself"};
    edits.first_id = static_cast<std::int64_t>(next);
  }
  bool follow = !scene.ids && edits.removed == 0;
  std::uint64_t taken = kNone;
  if (edits.inserted > 0 && !scene.particles.has_weights) edits.inserted_counts.resize(scene.loads.counts.size());
  const bool tells_parts = comm.rank() == 0 && edits.inserted_part.try_reserve(edits.inserted);
  Arriving arriving(comm, scene, edits);
  particles::ParticleSet piece;
  piece.dims = scene.options.dims;
  piece.has_weights = in.has_weights;
  Buffer<std::int32_t> part;
  for (Pieces pieces(comm, in.slice, edits.inserted); !pieces.done(); pieces.next()) {
    for (std::size_t a = 0; a < in.dims; ++a) pieces.get(a, piece.position[a]);
    if (in.has_weights) pieces.get(in.dims, piece.weight);
    if (in.has_ids) {
      pieces.get(in.ids(), piece.id);
      const IdIndex& index = index_of(scene);
      for (const particles::Id id : piece.id)
        if (index.slot.contains(id)) taken = std::min(taken, static_cast<std::uint64_t>(id));
    } else {
      piece.id.resize(pieces.size());
      std::iota(piece.id.begin(), piece.id.end(), static_cast<particles::Id>(next + pieces.first()));
    }
    for (std::size_t i = 0; i < piece.id.size(); ++i) {
      const auto id = static_cast<std::uint64_t>(piece.id[i]);
      follow = follow && id == scene.n + pieces.first() + i;
      edits.id_next = std::max(edits.id_next, id + 1);
    }
    part.resize(pieces.size());
    scene.tree.classify(piece.view(), part.span());
    arriving.add(piece, part.span());
    for (const std::int32_t p : part)
      if (!edits.inserted_counts.empty()) ++edits.inserted_counts[static_cast<std::size_t>(p)];
    if (tells_parts) edits.inserted_part.append(part.span());
  }
  edits.ids = !follow;
  if (in.has_ids) {
    comm.all_min({&taken, 1});
    if (taken != kNone)
      return {Code::already_exists, fmt::format("particle {} is to be inserted, and the scene has it", taken),
              "the previous step stands; an id may be used again after the step that removes it"};
  }
  const bool all = arriving.finish() && (comm.rank() != 0 || tells_parts);
  Status good = reserve_arrivals(scene, edits.arriving.count(), comm.rank());
  if (!all) good = {Code::too_large, fmt::format("rank {} has no memory for the inserted particles", comm.rank())};
  return agree_status(comm, good);
}

// Gives every rank the parts of all removed particles. Collective.
void share_removed_parts(comm::Comm& comm, const Scene& scene, Edits& edits) {
  std::vector<std::int32_t> mine;
  for (const std::uint64_t slot : edits.removed_slots) mine.push_back(scene.part[slot]);
  edits.removed_parts = comm::all_gather_values<std::int32_t>(comm, mine).values;
}

// Checks that the slots are ascending and that this rank has them.
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

// Order "id": rank 0's one slice goes round; each rank keeps the particles it holds. Collective.
Status receive_by_id(Context& context, Scene& scene, std::uint64_t count, particles::ParticleSet& arrays,
                     Subset& subset) {
  comm::Comm& comm = context.comm;
  const PushSlice slice = take_slice(context.slices, 0);
  const auto dims = static_cast<std::size_t>(scene.options.dims);
  Expected expected = axes_of(scene);
  expected.emplace_back("id", "<i8");
  Status good;
  if (context.root() && (count > 0 || !slice.arrays.empty())) good = check_arrays(slice, "moved", count, expected);
  const auto ids = values_of<particles::Id>(slice, dims);
  for (std::size_t k = 1; k < ids.size() && good.ok(); ++k)
    if (ids[k] <= ids[k - 1])
      good = {Code::invalid_argument, fmt::format("id {} follows id {}", ids[k], ids[k - 1]),
              "in order \"id\" moved particles come in ascending id, each once"};
  if (Status status = agree_status(comm, good); !status.ok()) return status;
  std::array<Buffer<double>, 3> piece;
  Status found = find_held(
      comm, scene, slice, dims, count, "moved",
      [&](Pieces& pieces) {
        for (std::size_t a = 0; a < dims; ++a) pieces.get(a, piece[a]);
      },
      [&](std::size_t k, particles::Id id, std::uint64_t slot) {
        for (std::size_t a = 0; a < dims; ++a) arrays.position[a].push_back(piece[a][k]);
        arrays.id.push_back(id);
        subset.slot.push_back(slot);
      });
  if (!found.ok()) return found;
  Buffer<std::uint64_t> order(subset.slot.size());
  std::iota(order.begin(), order.end(), std::uint64_t{0});
  std::sort(order.begin(), order.end(), [&](auto a, auto b) { return subset.slot[a] < subset.slot[b]; });
  Buffer<std::byte> spare;
  for (std::size_t a = 0; a < dims; ++a) put_in_order(arrays.position[a], order, spare);
  put_in_order(arrays.id, order, spare);
  put_in_order(subset.slot, order, spare);
  return {};
}

// Order "plan", all slices on rank 0: sends each rank its slice. Collective.
Status scatter_slices(Context& context, const Scene& scene, const api::Push& push, PushSlice& mine) {
  comm::Comm& comm = context.comm;
  Expected expected = axes_of(scene);
  expected.emplace_back("slot", "<u8");
  const auto ranks = static_cast<std::size_t>(comm.size());
  std::vector<PushSlice> slices(ranks);
  Status good;
  if (context.root()) {
    for (std::size_t r = 0; r < ranks; ++r) {
      slices[r] = take_slice(context.slices, static_cast<int>(r));
      if (good.ok() && (push.counts[r] > 0 || !slices[r].arrays.empty()))
        good = check_arrays(slices[r], fmt::format("moved of rank {}", r), push.counts[r], expected);
    }
    if (good.ok() && !context.slices.empty())
      good = {Code::invalid_argument, fmt::format("a second slice for rank {}", context.slices.front().rank)};
  }
  if (Status status = agree_status(comm, good); !status.ok()) return status;
  mine.rank = comm.rank();
  mine.count = push.counts[static_cast<std::size_t>(comm.rank())];
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

Status check_changes(const Scene& scene, const api::Push& push) {
  if (push.moved != Moved::all && !push.base_step)
    return {Code::invalid_argument, "a push of few particles names no 'base_step'",
            "name the step that the others' positions are those of"};
  if (push.base_step && scene.step != push.base_step)
    return {Code::base_lost,
            scene.step ? fmt::format("the push builds on step {}, the last step of scene '{}' is {}", *push.base_step,
                                     scene.name, *scene.step)
                       : fmt::format("the push builds on step {}, scene '{}' has no positions yet", *push.base_step,
                                     scene.name),
            "push all particles"};
  if (!scene.pushed && push.edits())
    return {Code::invalid_argument,
            fmt::format("scene '{}' has no particles yet to insert others beside or to remove", scene.name),
            "push a first step with all of them"};
  if (push.moved != Moved::all && push.weights)
    return {Code::invalid_argument, "weights are replaced all together", "push all particles with their weights"};
  if (push.removed > scene.n)
    return {Code::invalid_argument,
            fmt::format("{} particles are to be removed, scene '{}' has {}", push.removed, scene.name, scene.n)};
  if (scene.n + push.inserted - push.removed > static_cast<std::uint64_t>(wire::kParticlesMax))
    return {Code::too_large,
            fmt::format("scene '{}' would have more than {} particles", scene.name, wire::kParticlesMax)};
  return {};
}

Result<Edits> prepare_edits(Context& context, Scene& scene, const api::Push& push) {
  Edits edits;
  if (!push.edits()) return edits;
  edits.inserted = push.inserted;
  edits.removed = push.removed;
  comm::Comm& comm = context.comm;
  const Inserted in{take_slice(context.slices, wire::kInsertedSlice), static_cast<std::size_t>(scene.options.dims),
                    scene.particles.has_weights, push.inserted_ids};
  const PushSlice removed = take_slice(context.slices, wire::kRemovedSlice);
  Expected arrays = axes_of(scene);
  if (in.has_weights) arrays.emplace_back("w", "<f8");
  if (in.has_ids) arrays.emplace_back("id", "<i8");
  Status good;
  if (context.root() && push.inserted > 0) good = check_arrays(in.slice, "inserted", push.inserted, arrays);
  if (context.root() && push.removed > 0 && good.ok())
    good = check_arrays(removed, "removed", push.removed, {{"id", "<i8"}});
  if (context.root() && good.ok()) good = check_inserted(in, removed);
  if (Status status = agree_status(comm, good); !status.ok()) return status;
  if (push.removed > 0) {
    Status found = find_held(
        comm, scene, removed, 0, push.removed, "removed", [](Pieces&) {},
        [&edits](std::size_t, particles::Id, std::uint64_t slot) { edits.removed_slots.push_back(slot); });
    if (!found.ok()) return found;
    std::sort(edits.removed_slots.begin(), edits.removed_slots.end());
    share_removed_parts(comm, scene, edits);
  }
  if (Status status = insert(comm, scene, in, edits); !status.ok()) return status;
  return edits;
}

Status receive_subset(Context& context, Scene& scene, const PushRequest& push, particles::ParticleSet& arrays,
                      Subset& subset, Status& ready) {
  comm::Comm& comm = context.comm;
  if (push.by_id) return receive_by_id(context, scene, push.counts.front(), arrays, subset);
  const auto dims = static_cast<std::size_t>(scene.options.dims);
  PushSlice mine;
  if (push.staged) {
    Expected expected = axes_of(scene);
    expected.emplace_back("slot", "<u8");
    if (push.members() > 0) ready = join_few_of_members(comm, scene, push.members(), context.slices);
    if (!ready.ok()) return {};
    mine = take_slice(context.slices, comm.rank());
    ready = check_arrays(mine, fmt::format("moved of rank {}", comm.rank()),
                         push.counts[static_cast<std::size_t>(comm.rank())], expected);
  } else if (Status status = scatter_slices(context, scene, push, mine); !status.ok()) {
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
