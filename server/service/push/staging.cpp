#include "server/service/push/staging.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

#include <fmt/format.h>

#include "common/layout/layout.hpp"
#include "server/service/context/collective.hpp"
#include "server/service/push/arrays.hpp"
#include "server/service/push/member_slices.hpp"
#include "server/service/push/values.hpp"

namespace rcb::service {
namespace {

// Rank 0: checks that every rank that holds particles has exactly one slice, of the right length.
Status check_slices(const Context& context, const Scene& scene, const PushRequest& push) {
  const int ranks = context.comm.size();
  const ArrayTypes types = arrays_of(scene, push);
  std::vector<bool> seen(static_cast<std::size_t>(ranks), false);
  for (const PushSlice& slice : context.slices) {
    if (slice.rank < 0 || slice.rank >= ranks)
      return {Code::invalid_argument, fmt::format("slice for rank {} of {}", slice.rank, ranks)};
    if (seen[static_cast<std::size_t>(slice.rank)])
      return {Code::invalid_argument, fmt::format("two slices for rank {}", slice.rank)};
    seen[static_cast<std::size_t>(slice.rank)] = true;
    const std::uint64_t expected =
        push.by_id ? (slice.rank == 0 ? push.n : 0) : held_by(scene, push.n, slice.rank, ranks);
    if (slice.count != expected)
      return {Code::stale_plan,
              fmt::format("slice of rank {} has {} particles, the plan has {}", slice.rank, slice.count, expected),
              "fetch the plan and push again"};
    if (Status status = check_arrays(slice, fmt::format("particles of rank {}", slice.rank), expected, types);
        !status.ok())
      return status;
  }
  for (int r = 0; r < ranks; ++r) {
    const bool needed = push.by_id ? r == 0 && push.n > 0 : held_by(scene, push.n, r, ranks) > 0;
    if (needed && !seen[static_cast<std::size_t>(r)])
      return {Code::invalid_argument, fmt::format("the slice of rank {} is missing", r)};
  }
  return {};
}

// For each particle in the layout's order, its index in an array sorted by ascending id.
Buffer<std::uint64_t> places_by_id(const Scene& scene, Buffer<particles::Id> plan_ids) {
  if (!scene.ids) return plan_ids.release_as<std::uint64_t>();
  Buffer<std::uint64_t> places(plan_ids.size());
  Buffer<particles::Id> sorted = plan_ids;
  std::sort(sorted.begin(), sorted.end());
  for (std::size_t k = 0; k < plan_ids.size(); ++k)
    places[k] =
        static_cast<std::uint64_t>(std::lower_bound(sorted.begin(), sorted.end(), plan_ids[k]) - sorted.begin());
  return places;
}

Buffer<std::byte> permuted(const Buffer<std::byte>& values, const Buffer<std::uint64_t>& places) {
  Buffer<std::byte> out(values.size());
  for (std::size_t k = 0; k < places.size(); ++k) std::memcpy(out.data() + 8 * k, values.data() + 8 * places[k], 8);
  return out;
}

// Array a of rank 0's own slice, if the push is in the layout's order: it can be taken without a copy. Else nullptr.
Buffer<std::byte>* own_piece(Context& context, const PushRequest& push, std::size_t a) {
  if (!context.root() || push.by_id) return nullptr;
  for (PushSlice& slice : context.slices)
    if (slice.rank == 0) return &slice.arrays[a].bytes;
  return nullptr;
}

// Sends array a of every slice to its rank, except for own_piece(). Collective.
void scatter_array(Context& context, const Scene& scene, const PushRequest& push, std::size_t a,
                   const Buffer<std::uint64_t>& places, std::span<std::byte> mine) {
  const int ranks = context.comm.size();
  std::vector<std::span<const std::byte>> pieces;
  Buffer<std::byte> sorted;
  if (context.root()) {
    pieces.resize(static_cast<std::size_t>(ranks));
    if (push.by_id && push.n > 0) {
      Buffer<std::byte>& whole = context.slices.front().arrays[a].bytes;
      if (scene.pushed) sorted = permuted(whole, places);
      const std::span<const std::byte> all = scene.pushed ? sorted.span() : whole.span();
      std::uint64_t at = 0;
      for (int r = 0; r < ranks; ++r) {
        const std::uint64_t count = held_by(scene, push.n, r, ranks);
        pieces[static_cast<std::size_t>(r)] = all.subspan(8 * at, 8 * count);
        at += count;
      }
    } else {
      for (const PushSlice& slice : context.slices)
        if (slice.rank != 0) pieces[static_cast<std::size_t>(slice.rank)] = slice.arrays[a].bytes.span();
    }
  }
  context.comm.scatter(pieces, 0, mine);
  if (context.root())  // frees the memory of what was sent, for the next array
    for (PushSlice& slice : context.slices)
      if (a < slice.arrays.size() && (slice.rank != 0 || push.by_id)) slice.arrays[a].bytes.release();
}

// Checks the slice that this rank received directly.
Status check_own_slice(const Context& context, const Scene& scene, const PushRequest& push, std::uint64_t held) {
  if (context.slices.size() != 1 || context.slices.front().rank != context.comm.rank())
    return {Code::internal, fmt::format("rank {} has no slice of the push", context.comm.rank())};
  const PushSlice& slice = context.slices.front();
  if (slice.count != held)
    return {Code::stale_plan,
            fmt::format("slice of rank {} has {} particles, the plan has {}", slice.rank, slice.count, held),
            "fetch the plan and push again"};
  return check_arrays(slice, fmt::format("particles of rank {}", slice.rank), held, arrays_of(scene, push));
}

// Makes the slice's arrays the staged ones, without a copy.
void take_own_slice(Context& context, const PushRequest& push, Staged& staged) {
  std::vector<wire::Array>& arrays = context.slices.front().arrays;
  const auto dims = static_cast<std::size_t>(staged.arrays.dims);
  staged.scan.ranges = std::move(context.slices.front().ranges);
  for (std::size_t a = 0; a < dims; ++a) staged.arrays.position[a] = arrays[a].bytes.release_as<double>();
  if (push.weights) staged.arrays.weight = arrays[dims].bytes.release_as<double>();
  if (push.ids) staged.arrays.id = arrays[dims + (push.weights ? 1 : 0)].bytes.release_as<particles::Id>();
  context.slices.clear();
}

bool reserve(particles::ParticleSet& set, std::uint64_t count, bool ids) {
  bool fits = true;
  for (std::size_t a = 0; a < static_cast<std::size_t>(set.dims); ++a)
    fits = fits && set.position[a].try_reserve(count);
  if (set.has_weights) fits = fits && set.weight.try_reserve(count);
  return fits && (!ids || set.id.try_reserve(count));
}

// Sends the slices that rank 0 received to their ranks. Collective.
Status distribute(Context& context, Scene& scene, const PushRequest& push, std::uint64_t mine, Staged& staged) {
  comm::Comm& comm = context.comm;
  Status ready;
  if (context.root()) ready = check_slices(context, scene, push);
  for (std::size_t a = 0; a < scene.spare.size(); ++a) staged.arrays.position[a].swap(scene.spare[a]);
  if (ready.ok() && !reserve(staged.arrays, mine, !scene.pushed))
    ready = {Code::too_large, fmt::format("rank {} has no memory for {} particles", comm.rank(), mine)};
  const bool in_order = push.by_id && scene.pushed;
  constexpr std::uint64_t kBytesInOrder = 32;  // ids, sorted ones too, their places, and an array in that order
  if (ready.ok() && in_order && context.root())
    ready = room_for(comm, scene.n * kBytesInOrder, fmt::format("the order of {} particles by id", scene.n));
  if (Status status = agree_status(comm, ready); !status.ok()) return status;
  Buffer<std::uint64_t> places;
  if (in_order) {
    auto plan_ids = gather_values<particles::Id>(comm, scene.particles.id.span());
    if (context.root()) places = places_by_id(scene, std::move(plan_ids));
  }
  std::size_t a = 0;
  const auto receive = [&](auto& buffer) {
    Buffer<std::byte>* own = own_piece(context, push, a);
    buffer.resize(own == nullptr ? mine : 0);
    scatter_array(context, scene, push, a++, places, std::as_writable_bytes(buffer.span()));
    if (own != nullptr) buffer = own->template release_as<std::remove_reference_t<decltype(buffer[0])>>();
  };
  for (std::size_t axis = 0; axis < static_cast<std::size_t>(staged.arrays.dims); ++axis)
    receive(staged.arrays.position[axis]);
  if (push.weights) receive(staged.arrays.weight);
  if (push.ids) receive(staged.arrays.id);
  return {};
}

// A scene's first push: checks every value; makes the ids, or checks those that came. Collective.
Status check_first(comm::Comm& comm, const PushRequest& push, std::uint64_t mine, int parts, Staged& staged) {
  const std::uint64_t first_row = layout::row_begin(comm.rank(), push.n, comm.size());
  if (!push.ids) {
    staged.arrays.id.resize(mine);
    for (std::uint64_t i = 0; i < mine; ++i) staged.arrays.id[i] = static_cast<particles::Id>(first_row + i);
  }
  if (Status status = check_values(comm, staged.arrays.view(), true, first_row); !status.ok()) return status;
  if (push.ids)
    if (const auto twin = duplicate_id(comm, staged.arrays.id.span()))
      return {Code::invalid_argument, fmt::format("id {} occurs more than once", *twin), "ids must be distinct"};
  return agree_room_to_partition(comm, mine, parts, push.changes ? push.n : 0);
}

// Makes room for the positions of `mine` particles, if possible in the memory of the last push.
Status take_room(const comm::Comm& comm, Scene& scene, std::uint64_t mine, Staged& staged) {
  for (std::size_t a = 0; a < scene.spare.size(); ++a) staged.arrays.position[a].swap(scene.spare[a]);
  if (!reserve(staged.arrays, mine, !scene.pushed))
    return {Code::too_large, fmt::format("rank {} has no memory for {} particles", comm.rank(), mine)};
  for (std::size_t a = 0; a < static_cast<std::size_t>(staged.arrays.dims); ++a) staged.arrays.position[a].resize(mine);
  if (staged.arrays.has_weights) staged.arrays.weight.resize(mine);
  return {};
}

// In the shared memory, of this rank's particles.
std::span<const particles::Id> rows_of(const Scene& scene, const PushRequest& push, const Staged& staged) {
  return push.by_id ? scene.particles.id.span() : staged.rows.span();
}

// Opens the shared memory, and reads from it what a later push's scan doesn't: weights, and at a first push everything.
// The positions of a later push are read with the scan. Local.
Status read_shared(const Context& context, Scene& scene, const PushRequest& push, std::uint64_t mine, Staged& staged) {
  const comm::Comm& comm = context.comm;
  if (context.slices.empty()) return {Code::internal, fmt::format("rank {} has no slice of the push", comm.rank())};
  auto source = SharedSource::open(context.slices.front(), scene.options.dims);
  if (!source.ok()) return source.status();
  if (Status room = take_room(comm, scene, mine, staged); !room.ok()) return room;
  if (scene.pushed) {
    const PushSlice& slice = context.slices.front();
    if (!push.by_id && slice.count != mine)
      return {Code::stale_plan,
              fmt::format("{} rows are listed for rank {}, which holds {}", slice.count, comm.rank(), mine),
              "fetch the plan and push again"};
    if (!push.by_id && !staged.rows.try_reserve(mine))
      return {Code::too_large, fmt::format("rank {} has no memory for {} particles", comm.rank(), mine)};
    if (!push.by_id) {
      staged.rows.resize(mine);
      if (Status listed = source->rows(staged.rows.data()); !listed.ok()) return listed;
    }
    if (push.weights) source->weights(rows_of(scene, push, staged), staged.arrays.weight.data());
    staged.source = std::move(*source);
    return {};
  }
  const std::uint64_t first = layout::row_begin(comm.rank(), push.n, comm.size());
  for (std::size_t a = 0; a < static_cast<std::size_t>(scene.options.dims); ++a)
    source->positions(a, first, mine, staged.arrays.position[a].data());
  if (push.weights) source->weights(first, mine, staged.arrays.weight.data());
  if (push.ids) {
    staged.arrays.id.resize(mine);
    source->ids(first, mine, staged.arrays.id.data());
  }
  return {};
}

// Once a step has changed anything it must not lack memory for new cuts or for particles that change rank. So there
// must be room for the most that a rank may get of either before it is known whether it is needed. Local.
Status room_for_step(const comm::Comm& comm, const Scene& scene, const PushRequest& push, const Staged& staged) {
  const std::uint64_t mean = scene.n / static_cast<std::uint64_t>(comm.size());
  const std::uint64_t most = std::max<std::uint64_t>(scene.particles.count(), mean) + push.inserted;
  // A search among all particles begins by freeing the staged positions.
  std::uint64_t freed = 0;
  for (const auto& axis : staged.arrays.position) freed += axis.capacity() * sizeof(double);
  return room_to_partition(comm, most, scene.options.parts, push.changes ? push.n : 0, freed);
}

// Where drift alone brings a rank more than that.
Status agree_room_to_migrate(comm::Comm& comm, const Scene& scene, const StepSums& sums) {
  constexpr std::uint64_t kFew = 65536;
  if (sums.migrating <= std::max(kFew, scene.n / static_cast<std::uint64_t>(comm.size()))) return {};
  const auto ranks = static_cast<std::size_t>(comm.size());
  const auto rank = static_cast<std::size_t>(comm.rank());
  std::uint64_t arriving = sums.from_to.empty() ? sums.migrating : 0;
  if (!sums.from_to.empty())
    for (std::size_t r = 0; r < ranks; ++r) arriving += sums.from_to[r * ranks + rank];
  constexpr std::uint64_t kBytesOfParticle = 64;  // its values, and as they arrive
  return agree_room(comm, arriving * kBytesOfParticle, fmt::format("{} particles that change rank", arriving));
}

// A later push: one scan and one reduction. `ready`: a fault that only this rank knows of. Collective.
Status check_later(Context& context, Scene& scene, const PushRequest& push, Status ready, Staged& staged) {
  comm::Comm& comm = context.comm;
  if (ready.ok()) ready = room_for_step(comm, scene, push, staged);
  particles::ParticleView view = staged.arrays.view();
  const bool all = push.moved == Moved::all;
  if (all) {
    view.count = scene.particles.count();
    view.id = scene.particles.id.data();
  }
  if (ready.ok() && staged.source)
    staged.scan = scan_shared(scene, *std::exchange(staged.source, {}), rows_of(scene, push, staged), staged.arrays,
                              comm.rank(), comm.size());
  else if (ready.ok())
    staged.scan = all ? scan_positions(scene, view, std::move(staged.scan.ranges), comm.rank(), comm.size())
                      : scan_subset(scene, view, staged.subset.slot.span(), comm.rank(), comm.size());
  forget_removed(staged.edits, staged.scan.drift);
  staged.sums = sum_scans(comm, scene, staged.scan, !ready.ok() || staged.scan.fault);
  if (staged.sums.faults == 0) return agree_room_to_migrate(comm, scene, staged.sums);
  if (Status status = agree_status(comm, ready); !status.ok()) return status;
  Status status = check_values(comm, view, false, 0);
  RCB_CHECK(!status.ok(), "the pass found a fault that isn't there");
  return status;
}

// Bytes of all arrays as received.
std::uint64_t bytes_of(const Scene& scene, const PushRequest& push) {
  const std::uint64_t point = static_cast<std::uint64_t>(scene.options.dims) * (push.is_float32 ? 4U : 8U);
  const std::uint64_t beside = (push.weights ? 8U : 0U) + (push.ids || push.moved == Moved::some ? 8U : 0U);
  const std::uint64_t inserted = point + (scene.particles.has_weights ? 8U : 0U) + (push.inserted_ids ? 8U : 0U);
  return push.moving() * (point + beside) + push.inserted * inserted + push.removed * 8;
}

}  // namespace

std::uint64_t held_by(const Scene& scene, std::uint64_t n, int rank, int ranks) {
  if (!scene.pushed) return layout::row_begin(rank + 1, n, ranks) - layout::row_begin(rank, n, ranks);
  std::uint64_t held = 0;
  const int parts = scene.options.parts;
  for (std::int64_t p = layout::part_begin(rank, parts, ranks); p < layout::part_begin(rank + 1, parts, ranks); ++p)
    held += scene.loads.counts[static_cast<std::size_t>(p)];
  return held;
}

void give_back(Context& context, Scene& scene, const PushRequest& push, Staged& staged) {
  if (push.moved == Moved::none) return;  // the kept memory stays for a later push
  scene.spare = {};
  // A slice's buffers go back to the listener that received it. What was read, joined or handed out here stays here.
  const bool received = push.staged && !(push.from_memory(context.comm.rank()) && push.members() == 0);
  if (!received || staged.joined) scene.spare = std::move(staged.arrays.position);
  Spare spare{scene.name, {}};
  if (received) {
    for (auto& axis : staged.arrays.position)
      if (axis.capacity() > 0) spare.buffers.push_back(axis.release_as<std::byte>());
    if (spare.buffers.empty()) return;
  }
  context.spares.push_back(std::move(spare));
}

Result<Staged> prepare(Context& context, Scene& scene, const PushRequest& push) {
  const double start = context.clock.seconds();
  comm::Comm& comm = context.comm;
  if (Status status = check_request(scene, push); !status.ok()) return status;

  Staged staged;
  staged.n = push.n;
  staged.ids = scene.pushed ? scene.ids : push.ids;
  staged.arrays.dims = scene.options.dims;
  staged.arrays.has_weights = push.weights;
  staged.bytes = bytes_of(scene, push);
  auto edits = prepare_edits(context, scene, push);
  if (!edits.ok()) return edits.status();
  staged.edits = std::move(*edits);
  if (push.moved == Moved::none) {
    if (push.edits())
      if (Status room = agree_status(comm, room_for_step(comm, scene, push, staged)); !room.ok()) return room;
    staged.seconds = context.received_seconds + context.clock.seconds() - start;
    return staged;
  }
  const std::uint64_t mine = scene.pushed ? scene.particles.count() : held_by(scene, push.n, comm.rank(), comm.size());
  Status ready;
  if (push.moved == Moved::some) {
    Status status = receive_subset(context, scene, push, staged.arrays, staged.subset, ready);
    if (!status.ok()) return status;
  } else if (push.from_memory(comm.rank()) && push.members() == 0) {
    ready = read_shared(context, scene, push, mine, staged);
    if (!scene.pushed)
      if (Status status = agree_status(comm, ready); !status.ok()) return status;
  } else if (push.staged) {
    if (push.members() > 0) {
      auto joined = join_member_slices(comm, scene, push.moved_by, arrays_of(scene, push), scene.spare, context.slices);
      ready = joined.status();
      staged.joined = joined.ok() && *joined;
    }
    if (ready.ok()) ready = check_own_slice(context, scene, push, mine);
    if (ready.ok()) take_own_slice(context, push, staged);
    if (!scene.pushed)
      if (Status status = agree_status(comm, ready); !status.ok()) return status;
  } else if (Status status = distribute(context, scene, push, mine, staged); !status.ok()) {
    return status;
  }
  // The staged arrays become the scene's, so they need room for the inserted particles, too.
  const std::uint64_t arriving = staged.edits.arriving.count();
  if (ready.ok() && arriving > 0 && push.moved == Moved::all && !reserve(staged.arrays, mine + arriving, false))
    ready = {Code::too_large, fmt::format("rank {} has no memory for {} more particles", comm.rank(), arriving)};
  const Status checked = scene.pushed ? check_later(context, scene, push, ready, staged)
                                      : check_first(comm, push, mine, scene.options.parts, staged);
  if (!checked.ok()) return checked;
  staged.seconds = context.received_seconds + context.clock.seconds() - start;
  return staged;
}

}  // namespace rcb::service
