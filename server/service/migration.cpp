#include "server/service/migration.hpp"

#include <algorithm>
#include <cstring>
#include <numeric>
#include <tuple>
#include <type_traits>
#include <utility>

#include "common/partition/comm.hpp"
#include "common/plan/plan.hpp"
#include "server/service/collective.hpp"

namespace rcb::service {
namespace {

// The local particles that leave, grouped by destination, each group in ascending slot order.
struct Leavers {
  std::vector<std::uint64_t> counts;  // by rank
  std::vector<std::uint64_t> slots;   // ascending
  Buffer<std::uint64_t> grouped;      // slots, group after group
};

bool is_own(const partition::Comm& comm, const Scene& scene, std::int32_t part) {
  return part >= plan::part_begin(comm.rank(), scene.options.parts, comm.size()) &&
         part < plan::part_begin(comm.rank() + 1, scene.options.parts, comm.size());
}

// Fills in counts and groups.
void group_by_rank(const partition::Comm& comm, const Scene& scene, Leavers& leavers) {
  const int ranks = comm.size();
  leavers.counts.assign(static_cast<std::size_t>(ranks), 0);
  std::vector<std::int32_t> to(leavers.slots.size());
  for (std::size_t k = 0; k < to.size(); ++k) {
    to[k] = plan::rank_of_part(scene.part[leavers.slots[k]], scene.options.parts, ranks);
    ++leavers.counts[static_cast<std::size_t>(to[k])];
  }
  std::vector<std::uint64_t> at(static_cast<std::size_t>(ranks), 0);
  std::exclusive_scan(leavers.counts.begin(), leavers.counts.end(), at.begin(), std::uint64_t{0});
  leavers.grouped.resize(leavers.slots.size());
  for (std::size_t k = 0; k < to.size(); ++k) leavers.grouped[at[static_cast<std::size_t>(to[k])]++] = leavers.slots[k];
}

Leavers find_leavers(const partition::Comm& comm, const Scene& scene) {
  const int ranks = comm.size();
  const std::int64_t mine_begin = plan::part_begin(comm.rank(), scene.options.parts, ranks);
  const std::int64_t mine_end = plan::part_begin(comm.rank() + 1, scene.options.parts, ranks);
  Leavers leavers;
  for (std::size_t i = 0; i < scene.part.size(); ++i)
    if (scene.part[i] < mine_begin || scene.part[i] >= mine_end) leavers.slots.push_back(i);
  group_by_rank(comm, scene, leavers);
  return leavers;
}

struct Arrivals {
  particles::ParticleSet particles;
  Buffer<std::int32_t> part;
};

// Calls apply(scene array, arrivals array) for every array that a particle has.
template <typename Apply>
void for_each_array(Scene& scene, Arrivals& arrivals, const Apply& apply) {
  for (std::size_t a = 0; a < static_cast<std::size_t>(scene.options.dims); ++a)
    apply(scene.particles.position[a], arrivals.particles.position[a]);
  apply(scene.particles.id, arrivals.particles.id);
  if (scene.particles.has_weights) apply(scene.particles.weight, arrivals.particles.weight);
  apply(scene.part, arrivals.part);
}

// An array to leave from and the one to arrive in.
struct Column {
  const std::byte* from;
  std::byte* to;
  std::size_t width;  // bytes of an element
};

// The leavers of these columns to their ranks, in one exchange: for each destination column after column. Collective.
void exchange_columns(partition::Comm& comm, const Leavers& leavers, std::span<const std::uint64_t> from_counts,
                      std::span<const Column> columns) {
  std::size_t width = 0;
  for (const Column& column : columns) width += column.width;
  const std::uint64_t arriving = std::accumulate(from_counts.begin(), from_counts.end(), std::uint64_t{0});
  Buffer<std::byte> packed(leavers.grouped.size() * width);
  Buffer<std::byte> arrived(arriving * width);
  std::vector<std::span<const std::byte>> send;
  std::vector<std::span<std::byte>> receive;
  std::byte* to = packed.data();
  std::byte* at = arrived.data();
  const std::uint64_t* slots = leavers.grouped.data();
  for (std::size_t r = 0; r < from_counts.size(); ++r) {
    send.emplace_back(to, leavers.counts[r] * width);
    receive.emplace_back(at, from_counts[r] * width);
    at += from_counts[r] * width;
    for (const Column& column : columns)
      for (std::uint64_t k = 0; k < leavers.counts[r]; ++k, to += column.width)
        std::memcpy(to, column.from + slots[k] * column.width, column.width);
    slots += leavers.counts[r];
  }
  comm.exchange(send, receive);
  packed.release();
  std::uint64_t before = 0;
  for (std::size_t r = 0; r < from_counts.size(); ++r) {
    const std::byte* from = receive[r].data();
    for (const Column& column : columns) {
      const std::size_t bytes = from_counts[r] * column.width;
      if (bytes > 0) std::memcpy(column.to + before * column.width, from, bytes);
      from += bytes;
    }
    before += from_counts[r];
  }
}

// changed: of all ranks together. Few are exchanged all columns at once, since each exchange has its price in
// waiting; many column by column, since that takes less memory.
Arrivals exchange_leavers(partition::Comm& comm, Scene& scene, const Leavers& leavers,
                          std::span<const std::uint64_t> from, std::uint64_t changed) {
  constexpr std::uint64_t kFewMax = 100'000;
  Arrivals arrivals;
  arrivals.particles.dims = scene.options.dims;
  arrivals.particles.has_weights = scene.particles.has_weights;
  const std::uint64_t count = std::accumulate(from.begin(), from.end(), std::uint64_t{0});
  arrivals.particles.resize(count);
  arrivals.part.resize(count);
  std::vector<Column> columns;
  for_each_array(scene, arrivals, [&columns](auto& mine, auto& theirs) {
    columns.push_back(
        {std::as_bytes(mine.span()).data(), std::as_writable_bytes(theirs.span()).data(), sizeof(mine[0])});
  });
  if (changed <= kFewMax) {
    exchange_columns(comm, leavers, from, columns);
  } else {
    for (const Column& column : columns) exchange_columns(comm, leavers, from, {&column, 1});
  }
  return arrivals;
}

// Puts particles into ascending id.
void sort_by_id(particles::ParticleSet& particles, Buffer<std::int32_t>& part) {
  if (std::is_sorted(particles.id.begin(), particles.id.end())) return;
  const Buffer<std::uint64_t> order = order_by_id(particles.id);
  const auto permute = [&order](auto& values) {
    std::remove_reference_t<decltype(values)> sorted(values.size());
    for (std::size_t k = 0; k < order.size(); ++k) sorted[k] = values[order[k]];
    values.swap(sorted);
  };
  for (std::size_t a = 0; a < static_cast<std::size_t>(particles.dims); ++a) permute(particles.position[a]);
  if (particles.has_weights) permute(particles.weight);
  permute(part);
  permute(particles.id);  // last: the others are sorted by it
}

// A full change: stayers and arrivals together in ascending id.
void rebuild(Scene& scene, const Leavers& leavers, Arrivals& arrivals) {
  Buffer<std::uint64_t> stayers(scene.part.size() - leavers.slots.size());
  std::size_t kept = 0;
  std::size_t next = 0;
  for (std::uint64_t i = 0; i < scene.part.size(); ++i) {
    if (next < leavers.slots.size() && leavers.slots[next] == i) {
      ++next;
    } else {
      stayers[kept++] = i;
    }
  }
  for_each_array(scene, arrivals, [&](auto& mine, auto& theirs) {
    for (std::size_t k = 0; k < stayers.size(); ++k) mine[k] = mine[stayers[k]];
    mine.resize(stayers.size());
    mine.append(theirs.span());
    theirs.release();
  });
  sort_by_id(scene.particles, scene.part);
}

// The index of ids, where there is one, follows an edit that raises the plan's version by one.
void keep_index(Scene& scene, const plan::RankEdit& edit, const Leavers& leavers, const Arrivals& arrivals) {
  IdIndex& index = scene.index;
  if (index.plan_version != scene.plan_version) return;
  for (const std::uint64_t slot : leavers.slots) index.slot.erase(scene.particles.id[slot]);
  for (const plan::SlotMove& move : edit.moves)
    index.slot[move.arrival ? arrivals.particles.id[move.from] : scene.particles.id[move.from]] = move.to;
  index.plan_version = scene.plan_version + 1;
}

// A small change: free slots are filled, the rest stays where it is. Returns what the plan's checksum gains.
std::uint64_t fill_holes(Scene& scene, int rank, const Leavers& leavers, Arrivals& arrivals,
                         const plan::RankEdit& edit) {
  keep_index(scene, edit, leavers, arrivals);
  const std::uint64_t gain = plan::checksum_change(edit, rank, scene.particles.id.span(), leavers.slots,
                                                   std::as_const(arrivals.particles.id).span());
  for_each_array(scene, arrivals,
                 [&edit](auto& mine, auto& theirs) { plan::apply_edit(edit, mine, std::as_const(theirs).span()); });
  return gain;
}

// The particles change places, and the plan with them. Collective.
void hand_over(partition::Comm& comm, Scene& scene, const Leavers& leavers, Arrivals arrivals, bool full) {
  std::uint64_t checksum = 0;
  if (full) {
    rebuild(scene, leavers, arrivals);
    checksum = plan::checksum_of_rank(comm.rank(), scene.particles.id.span());
  } else {
    sort_by_id(arrivals.particles, arrivals.part);
    checksum = fill_holes(scene, comm.rank(), leavers, arrivals,
                          plan::edit_of_rank(scene.part.size(), leavers.slots, arrivals.part.size()));
  }
  comm.all_sum({&checksum, 1});
  scene.plan_checksum = full ? checksum : scene.plan_checksum + checksum;
  ++scene.plan_version;
}

}  // namespace

std::uint64_t migrate(partition::Comm& comm, Scene& scene, bool first) {
  const Leavers leavers = find_leavers(comm, scene);
  std::uint64_t changed = leavers.slots.size();
  comm.all_sum({&changed, 1});
  if (changed == 0 && !first) return 0;
  Arrivals arrivals;
  if (changed > 0) {
    std::vector<std::uint64_t> from(leavers.counts.size());
    partition::exchange_counts(comm, leavers.counts, from);
    arrivals = exchange_leavers(comm, scene, leavers, from, changed);
  } else {
    arrivals.particles.dims = scene.options.dims;
    arrivals.particles.has_weights = scene.particles.has_weights;
  }
  hand_over(comm, scene, leavers, std::move(arrivals), first || plan::is_full_change(changed, scene.n));
  return changed;
}

std::uint64_t migrate_drifted(partition::Comm& comm, Scene& scene, const Drift& drift, const StepSums& sums) {
  Leavers leavers;
  for (const std::uint64_t slot : drift.slot)
    if (!is_own(comm, scene, scene.part[slot])) leavers.slots.push_back(slot);
  group_by_rank(comm, scene, leavers);
  const auto ranks = static_cast<std::size_t>(comm.size());
  std::vector<std::uint64_t> from(ranks);
  if (sums.from_to.empty()) {
    partition::exchange_counts(comm, leavers.counts, from);
  } else {
    for (std::size_t r = 0; r < ranks; ++r) from[r] = sums.from_to[r * ranks + static_cast<std::size_t>(comm.rank())];
  }
  Arrivals arrivals = exchange_leavers(comm, scene, leavers, from, sums.migrating);
  hand_over(comm, scene, leavers, std::move(arrivals), plan::is_full_change(sums.migrating, scene.n));
  return sums.migrating;
}

void apply_edits(partition::Comm& comm, Scene& scene, Edits& edits, Drift& drift) {
  Leavers leavers;
  leavers.slots = std::move(edits.removed_slots);
  Arrivals arrivals{std::move(edits.arriving), std::move(edits.arriving_part)};
  const plan::RankEdit edit = plan::edit_of_rank(scene.part.size(), leavers.slots, arrivals.part.size());
  // Particles behind the new end have gone into holes before it: ascending slots, but into ascending holes.
  std::vector<std::pair<std::uint64_t, std::uint64_t>> moved;
  for (const plan::SlotMove& move : edit.moves)
    if (!move.arrival) moved.emplace_back(move.from, move.to);
  bool any = false;
  for (std::uint64_t& slot : drift.slot) {
    if (slot < edit.new_count) continue;
    const auto found = std::lower_bound(moved.begin(), moved.end(), std::pair{slot, std::uint64_t{0}});
    CHECK(found != moved.end() && found->first == slot, "a drifted particle is gone");
    slot = found->second;
    any = true;
  }
  if (any) {
    std::vector<std::pair<std::uint64_t, std::int32_t>> sorted;
    for (std::size_t k = 0; k < drift.count(); ++k) sorted.emplace_back(drift.slot[k], drift.part[k]);
    std::sort(sorted.begin(), sorted.end());
    for (std::size_t k = 0; k < sorted.size(); ++k) std::tie(drift.slot[k], drift.part[k]) = sorted[k];
  }
  std::uint64_t checksum = fill_holes(scene, comm.rank(), leavers, arrivals, edit);
  comm.all_sum({&checksum, 1});
  scene.plan_checksum += checksum;
  ++scene.plan_version;
  scene.n = scene.n + edits.inserted - edits.removed;
  scene.ids = edits.ids;
  scene.id_next = edits.id_next;
}

}  // namespace rcb::service
