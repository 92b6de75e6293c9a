#include "server/service/migration.hpp"

#include <algorithm>
#include <cstring>
#include <numeric>
#include <tuple>
#include <type_traits>
#include <utility>

#include "common/partition/comm.hpp"
#include "common/plan/plan.hpp"
#include "server/service/hand_over.hpp"

namespace rcb::service {
namespace {

bool is_own(const partition::Comm& comm, const Scene& scene, std::int32_t part) {
  return part >= plan::part_begin(comm.rank(), scene.options.parts, comm.size()) &&
         part < plan::part_begin(comm.rank() + 1, scene.options.parts, comm.size());
}

Leavers find_leavers(const partition::Comm& comm, const Scene& scene) {
  const int ranks = comm.size();
  const std::int64_t mine_begin = plan::part_begin(comm.rank(), scene.options.parts, ranks);
  const std::int64_t mine_end = plan::part_begin(comm.rank() + 1, scene.options.parts, ranks);
  Leavers leavers;
  for (std::size_t i = 0; i < scene.part.size(); ++i)
    if (scene.part[i] < mine_begin || scene.part[i] >= mine_end) leavers.slots.push_back(i);
  count_by_rank(comm, scene, leavers);
  return leavers;
}

// Collective.
std::uint64_t migrate_leavers(partition::Comm& comm, Scene& scene, Leavers leavers, bool first) {
  std::uint64_t changed = leavers.slots.size();
  comm.all_sum({&changed, 1});
  if (changed == 0 && !first) return 0;
  std::vector<std::uint64_t> from(leavers.counts.size());
  if (changed > 0) partition::exchange_counts(comm, leavers.counts, from);
  hand_over(comm, scene, std::move(leavers), from, changed, first || plan::is_full_change(changed, scene.n));
  return changed;
}

}  // namespace

std::uint64_t migrate(partition::Comm& comm, Scene& scene, bool first) {
  return migrate_leavers(comm, scene, find_leavers(comm, scene), first);
}

std::uint64_t migrate_touched(partition::Comm& comm, Scene& scene, std::vector<std::uint64_t> touched) {
  Leavers leavers;
  leavers.slots = std::move(touched);
  std::erase_if(leavers.slots, [&](std::uint64_t slot) { return is_own(comm, scene, scene.part[slot]); });
  count_by_rank(comm, scene, leavers);
  return migrate_leavers(comm, scene, std::move(leavers), false);
}

std::uint64_t migrate_drifted(partition::Comm& comm, Scene& scene, const Drift& drift, const StepSums& sums) {
  Leavers leavers;
  for (const std::uint64_t slot : drift.slot)
    if (!is_own(comm, scene, scene.part[slot])) leavers.slots.push_back(slot);
  count_by_rank(comm, scene, leavers);
  const auto ranks = static_cast<std::size_t>(comm.size());
  std::vector<std::uint64_t> from(ranks);
  if (sums.from_to.empty()) {
    partition::exchange_counts(comm, leavers.counts, from);
  } else {
    for (std::size_t r = 0; r < ranks; ++r) from[r] = sums.from_to[r * ranks + static_cast<std::size_t>(comm.rank())];
  }
  if (sums.migrating == 0) {  // asked for where the exchange isn't skipped
    comm.exchange(std::vector<std::span<const std::byte>>(ranks), std::vector<std::span<std::byte>>(ranks));
    return 0;
  }
  hand_over(comm, scene, std::move(leavers), from, sums.migrating, plan::is_full_change(sums.migrating, scene.n));
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
