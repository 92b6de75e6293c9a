#include "server/service/push/subset.hpp"

#include <algorithm>
#include <array>
#include <numeric>
#include <utility>

#include <fmt/format.h>

#include "server/service/context/collective.hpp"
#include "server/service/push/arrays.hpp"
#include "server/service/push/find_held.hpp"
#include "server/service/push/member_slices.hpp"

namespace rcb::service {
namespace {

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
  ArrayTypes expected = axes_of(scene);
  expected.emplace_back("id", "<i8");
  Status good;
  if (context.root() && (count > 0 || !slice.arrays.empty())) good = check_arrays(slice, "moved", count, expected);
  const auto ids = values_of<particles::Id>(slice, dims);
  for (std::size_t k = 1; k < ids.size() && good.ok(); ++k)
    if (ids[k] <= ids[k - 1])
      good = {Code::invalid_argument, fmt::format("id {} follows id {}", ids[k], ids[k - 1]),
              "in order \"id\" moved particles come in ascending id, each once"};
  // As they come, which at worst doubles them, and for putting them in order.
  const std::uint64_t most = std::min<std::uint64_t>(count, scene.particles.count());
  if (good.ok()) good = room_for(comm, most * (16 * (dims + 2) + 16), fmt::format("{} moved particles", most));
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
  const ArrayTypes expected = arrays_of_few(scene);
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

Status receive_subset(Context& context, Scene& scene, const PushRequest& push, particles::ParticleSet& arrays,
                      Subset& subset, Status& ready) {
  comm::Comm& comm = context.comm;
  if (push.by_id) return receive_by_id(context, scene, push.counts.front(), arrays, subset);
  const auto dims = static_cast<std::size_t>(scene.options.dims);
  PushSlice mine;
  if (push.staged) {
    if (push.members() > 0) ready = join_few_of_members(comm, scene, push.members(), context.slices);
    if (!ready.ok()) return {};
    mine = take_slice(context.slices, comm.rank());
    ready = check_arrays(mine, fmt::format("moved of rank {}", comm.rank()),
                         push.counts[static_cast<std::size_t>(comm.rank())], arrays_of_few(scene));
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

}  // namespace rcb::service
