#include "server/service/step/migration.hpp"

#include <algorithm>
#include <tuple>
#include <utility>

#include "common/comm/comm.hpp"
#include "common/layout/layout.hpp"
#include "server/service/step/exchange.hpp"

namespace rcb::service {
namespace {

layout::PartRange own_parts(const comm::Comm& comm, const Scene& scene) {
  return layout::parts_of_rank(comm.rank(), scene.options.parts, comm.size());
}

Exports find_exports(const comm::Comm& comm, const Scene& scene) {
  const layout::PartRange own = own_parts(comm, scene);
  Exports exports;
  for (std::size_t i = 0; i < scene.part.size(); ++i)
    if (!own.has(scene.part[i])) exports.slots.push_back(i);
  count_by_rank(comm, scene, exports);
  return exports;
}

// Collective.
std::uint64_t migrate_exports(comm::Comm& comm, Scene& scene, Exports exports, bool first) {
  std::uint64_t changed = exports.slots.size();
  comm.all_sum({&changed, 1});
  if (changed == 0 && !first) return 0;
  std::vector<std::uint64_t> from(exports.counts.size());
  if (changed > 0) comm::exchange_counts(comm, exports.counts, from);
  exchange_particles(comm, scene, std::move(exports), from, changed, first || layout::is_full_change(changed, scene.n));
  return changed;
}

}  // namespace

std::uint64_t migrate(comm::Comm& comm, Scene& scene, bool first) {
  return migrate_exports(comm, scene, find_exports(comm, scene), first);
}

std::uint64_t migrate_touched(comm::Comm& comm, Scene& scene, std::vector<std::uint64_t> touched) {
  Exports exports;
  exports.slots = std::move(touched);
  const layout::PartRange own = own_parts(comm, scene);
  std::erase_if(exports.slots, [&](std::uint64_t slot) { return own.has(scene.part[slot]); });
  count_by_rank(comm, scene, exports);
  return migrate_exports(comm, scene, std::move(exports), false);
}

std::uint64_t migrate_drifted(comm::Comm& comm, Scene& scene, const Drift& drift, const StepSums& sums) {
  Exports exports;
  const layout::PartRange own = own_parts(comm, scene);
  for (const std::uint64_t slot : drift.slot)
    if (!own.has(scene.part[slot])) exports.slots.push_back(slot);
  count_by_rank(comm, scene, exports);
  const auto ranks = static_cast<std::size_t>(comm.size());
  std::vector<std::uint64_t> from(ranks);
  if (sums.from_to.empty()) {
    comm::exchange_counts(comm, exports.counts, from);
  } else {
    for (std::size_t r = 0; r < ranks; ++r) from[r] = sums.from_to[r * ranks + static_cast<std::size_t>(comm.rank())];
  }
  if (sums.migrating == 0) {  // only with --no-skip exchange: an exchange of nothing, for measurement
    comm.exchange(std::vector<std::span<const std::byte>>(ranks), std::vector<std::span<std::byte>>(ranks));
    return 0;
  }
  exchange_particles(comm, scene, std::move(exports), from, sums.migrating,
                     layout::is_full_change(sums.migrating, scene.n));
  return sums.migrating;
}

void apply_edits(comm::Comm& comm, Scene& scene, Edits& edits, Drift& drift) {
  Exports exports;
  exports.slots = std::move(edits.removed_slots);
  Arrivals arrivals{std::move(edits.arriving), std::move(edits.arriving_part)};
  const layout::SlotEdit edit = layout::edit_of_rank(scene.part.size(), exports.slots, arrivals.part.size());
  // Particles beyond the new end have moved into holes below it. A drifted one among them gets its new slot, and the
  // drift is sorted again.
  std::vector<std::pair<std::uint64_t, std::uint64_t>> moved;
  for (const layout::SlotMove& move : edit.moves)
    if (!move.arrival) moved.emplace_back(move.from, move.to);
  bool any = false;
  for (std::uint64_t& slot : drift.slot) {
    if (slot < edit.new_count) continue;
    const auto found = std::lower_bound(moved.begin(), moved.end(), std::pair{slot, std::uint64_t{0}});
    RCB_CHECK(found != moved.end() && found->first == slot, "a drifted particle is gone");
    slot = found->second;
    any = true;
  }
  if (any) {
    std::vector<std::pair<std::uint64_t, std::int32_t>> sorted;
    for (std::size_t k = 0; k < drift.count(); ++k) sorted.emplace_back(drift.slot[k], drift.part[k]);
    std::sort(sorted.begin(), sorted.end());
    for (std::size_t k = 0; k < sorted.size(); ++k) std::tie(drift.slot[k], drift.part[k]) = sorted[k];
  }
  std::uint64_t checksum = fill_holes(scene, comm.rank(), exports, arrivals, edit);
  comm.all_sum({&checksum, 1});
  scene.plan_checksum += checksum;
  ++scene.plan_version;
  scene.n = scene.n + edits.inserted - edits.removed;
  scene.ids = edits.ids;
  scene.id_next = edits.id_next;
}

}  // namespace rcb::service
