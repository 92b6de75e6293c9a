#include "server/service/push/edits.hpp"

#include <algorithm>
#include <numeric>

#include <fmt/format.h>

#include "common/layout/layout.hpp"
#include "common/wire/limits.hpp"
#include "server/service/context/collective.hpp"
#include "server/service/push/arrays.hpp"
#include "server/service/push/find_held.hpp"
#include "server/service/push/values.hpp"

namespace rcb::service {
namespace {

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
  particles::ParticleView view;
  view.dims = static_cast<int>(in.dims);
  view.count = values_of<double>(in.slice, 0).size();
  for (std::size_t a = 0; a < in.dims; ++a) view.position[a] = values_of<double>(in.slice, a).data();
  if (in.has_weights) view.weight = values_of<double>(in.slice, in.dims).data();
  const auto ids = in.has_ids ? values_of<particles::Id>(in.slice, in.ids()) : std::span<const particles::Id>();
  if (in.has_ids) view.id = ids.data();
  if (const auto fault = first_fault(view))
    return {fault->code, fmt::format("inserted particle {} (index, from 0): {}", fault->particle, fault->text),
            kGoodValues};
  if (const auto twin = twin_of(ids))
    return {Code::invalid_argument, fmt::format("id {} is inserted more than once", *twin), "ids must be distinct"};
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
      : own_(layout::parts_of_rank(comm.rank(), scene.options.parts, comm.size())),
        set_(edits.arriving),
        parts_(edits.arriving_part) {
    set_.dims = scene.options.dims;
    set_.has_weights = scene.particles.has_weights;
  }

  void add(const particles::ParticleSet& piece, std::span<const std::int32_t> part) {
    std::size_t own = 0;
    for (const std::int32_t p : part) own += own_.has(p) ? 1U : 0U;
    full_ = full_ || !make_room_for(own);
    if (full_ || own == 0) return;
    for (std::size_t i = 0; i < part.size(); ++i) {
      if (!own_.has(part[i])) continue;
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
  bool make_room_for(std::size_t more) {
    const std::size_t count = set_.id.size() + more;
    bool fits = make_room(set_.id, count) && make_room(parts_, count);
    for (std::size_t a = 0; a < dims(); ++a) fits = fits && make_room(set_.position[a], count);
    return fits && (!set_.has_weights || make_room(set_.weight, count));
  }
  layout::PartRange own_;
  particles::ParticleSet& set_;
  Buffer<std::int32_t>& parts_;
  bool full_ = false;
};

// Hands the inserted particles round: each rank keeps those of its parts, in ascending id, and counts all by part.
// Gives them their ids, or checks those they bring. Collective.
Status insert(comm::Comm& comm, Scene& scene, const Inserted& in, Edits& edits) {
  const std::uint64_t next = id_next(comm, scene);
  edits.id_next = next;
  if (!in.has_ids && edits.inserted > 0) {
    const Result<particles::Id> first = first_of_ids(next, edits.inserted);
    if (!first.ok()) return first.status();
    edits.first_id = *first;
  }
  if (in.has_ids)
    if (Status made = make_index(comm, scene); !made.ok()) return made;
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
      for (const particles::Id id : piece.id)
        if (scene.index.slot.contains(id)) taken = std::min(taken, static_cast<std::uint64_t>(id));
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

}  // namespace

Result<particles::Id> first_of_ids(std::uint64_t next, std::uint64_t count) {
  constexpr std::uint64_t kEnd = std::uint64_t{1} << 63U;
  if (next > kEnd - count)
    return Status(Code::invalid_argument, "no ids are left above the greatest ever used", "choose the ids yourself");
  return static_cast<particles::Id>(next);
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
  ArrayTypes arrays = axes_of(scene);
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
