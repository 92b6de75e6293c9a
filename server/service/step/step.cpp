#include "server/service/step/step.hpp"

#include <algorithm>
#include <utility>

#include "common/layout/layout.hpp"
#include "common/partition/incremental/repartition.hpp"
#include "server/service/context/collective.hpp"
#include "server/service/step/exchange.hpp"
#include "server/service/step/gather_changes.hpp"
#include "server/service/step/migration.hpp"

namespace rcb::service {
namespace {

using scene::Decision;
using scene::Skip;

// The ids and parts of all local particles.
PartChanges all_changes(const Scene& scene) {
  PartChanges changes;
  changes.id.assign(scene.particles.id.span());
  changes.part.assign(scene.part.span());
  return changes;
}

// Local particles that new cuts moved to another part.
struct Moves {
  Buffer<std::uint64_t> slot;  // ascending
  Buffer<std::int32_t> old_part;
};

// Calls visit(slot, part before the step) for the particles that drifted or that new cuts moved, in ascending slots.
template <typename Visit>
void for_each_touched(const Drift& drift, const Moves& moves, const Visit& visit) {
  std::size_t d = 0;
  for (std::size_t m = 0; m < moves.slot.size(); ++m) {
    for (; d < drift.count() && drift.slot[d] < moves.slot[m]; ++d) visit(drift.slot[d], drift.part[d]);
    const bool both = d < drift.count() && drift.slot[d] == moves.slot[m];
    visit(moves.slot[m], both ? drift.part[d++] : moves.old_part[m]);
  }
  for (; d < drift.count(); ++d) visit(drift.slot[d], drift.part[d]);
}

// The particles whose part after the step isn't that before it. To be called before they migrate.
PartChanges changes_of_step(const Scene& scene, const Drift& drift, const Moves& moves) {
  PartChanges changes;
  changes.id.reserve(drift.count() + moves.slot.size());
  changes.part.reserve(drift.count() + moves.slot.size());
  for_each_touched(drift, moves, [&](std::uint64_t slot, std::int32_t old_part) {
    if (scene.part[slot] == old_part) return;
    changes.id.push_back(scene.particles.id[slot]);
    changes.part.push_back(scene.part[slot]);
  });
  return changes;
}

void note_skips(const Scene& scene, const api::Push& push, const NoSkip& no_skip, StepReport& report) {
  if (scene.options.dims < 3) report.skipped.add(Skip::dimension);
  if (!scene.particles.has_weights) report.skipped.add(Skip::weights);
  if (!scene.ids) report.skipped.add(Skip::ids);
  if (push.is_float32) report.skipped.add(Skip::double_precision);
  if (push.moved != Moved::all) report.skipped.add(Skip::motion);
  if (report.migrated == 0 && !no_skip.exchange) report.skipped.add(Skip::exchange);
  if (report.reductions == 0) report.skipped.add(Skip::search);
  if (report.reductions > 0 && report.searched < scene.n) report.skipped.add(Skip::far_from_cuts);
}

void take_positions(Scene& scene, Staged& staged, Moved moved) {
  if (moved == Moved::none) return;
  if (moved == Moved::some) {
    for (std::size_t a = 0; a < static_cast<std::size_t>(scene.options.dims); ++a)
      for (std::size_t k = 0; k < staged.subset.slot.size(); ++k)
        scene.particles.position[a][staged.subset.slot[k]] = staged.arrays.position[a][k];
    return;
  }
  for (std::size_t a = 0; a < static_cast<std::size_t>(scene.options.dims); ++a)
    scene.particles.position[a].swap(staged.arrays.position[a]);
  if (staged.arrays.has_weights) scene.particles.weight.swap(staged.arrays.weight);
}

void first_step(Context& context, Scene& scene, Staged& staged, StepReport& report) {
  scene.particles = std::move(staged.arrays);
  scene.n = staged.n;
  scene.ids = staged.ids;
  scene.pushed = true;
  const double start = context.clock.seconds();
  auto found = partition::partition(context.comm, scene.particles.view(), search_options(scene.options));
  RCB_CHECK(found.ok(), found.status().message());  // the options were checked when the scene was made
  report.searched = found->searched;
  report.rounds = found->rounds;
  report.reductions = found->reductions;
  scene.part = std::move(found->part);
  auto loads = found->counts.empty()
                   ? partition::summarise_loads(context.comm, scene.particles.view(), scene.part.span(),
                                                scene.options.part_sizes, scene.options.parts)
                   : partition::summarise_counts(std::move(found->counts), scene.options.part_sizes);
  adopt(scene, {std::move(found->tree), found->rounds, found->reductions}, std::move(loads));
  report.repartitioned = true;
  report.reason = "first positions";
  report.seconds.search = context.clock.seconds() - start;
}

constexpr int kFullSearchesMax = 7;

// Searches new cuts; returns them with the particles that they would move. Collective.
partition::Repartition search(Context& context, Scene& scene, Staged& staged, StepReport& report) {
  partition::RepartitionOptions options;
  options.partition = search_options(scene.options);
  options.partition.axis_hysteresis = scene.options.axis_hysteresis;
  options.partition.previous = &scene.tree;
  options.incremental = !context.no_skip.full_search && scene.full_searches_left == 0;
  options.before_search_of_all = [&staged] {
    for (auto& axis : staged.arrays.position) axis.release();  // a full search needs as much memory
  };
  const auto own = layout::parts_of_rank(context.comm.rank(), scene.options.parts, context.comm.size());
  // Insertions and removals have changed the slots, so the scan's ranges of blocks are no longer valid.
  const particles::BlockRanges* ranges = staged.edits.any() ? nullptr : staged.ranges();
  partition::Repartition found =
      partition::repartition(context.comm, scene.particles.view(), options,
                             {scene.tree, scene.part.span(), scene.loads, {own.begin, own.end}, ranges});
  // After a wasted incremental search the next 1, 3, then kFullSearchesMax repartitions search all particles.
  if (options.incremental)
    scene.full_searches_left = scene.full_searches_last =
        found.wasted ? std::min(2 * scene.full_searches_last + 1, kFullSearchesMax) : 0;
  else if (scene.full_searches_left > 0)
    --scene.full_searches_left;
  report.searched = found.looked_at;
  report.rounds = found.rounds;
  report.reductions = found.reductions;
  return found;
}

// Searches new cuts and adopts them if they lower the error; returns whether it did. Collective.
bool try_repartition(Context& context, Scene& scene, Staged& staged, const Decision& decision, double error_before,
                     Moves& moves, StepReport& report) {
  partition::Repartition found = search(context, scene, staged, report);
  if (may_be_wasted(scene.options, scene.loads) && !(found.loads.error < error_before)) {
    report.reason = reason_not_adopted(decision, found.loads.error);
    return false;
  }
  report.repartitioned = true;
  report.reason = reason_adopted(decision, found.loads.error);
  report.axes_flipped = cuts::axes_flipped(scene.tree, found.tree);
  report.moved = found.delta.slot.size();
  context.comm.all_sum({&report.moved, 1});
  moves.slot = std::move(found.delta.slot);
  moves.old_part = std::move(found.delta.part);
  for (std::size_t k = 0; k < moves.slot.size(); ++k) std::swap(scene.part[moves.slot[k]], moves.old_part[k]);
  adopt(scene, {std::move(found.tree), found.rounds, found.reductions}, std::move(found.loads));
  return true;
}

// Puts the parts that prepare() found in force, leaving the old ones in `drift`; then inserts and removes particles,
// and updates the loads. Collective.
void take_drift(Context& context, Scene& scene, Staged& staged) {
  Drift& drift = staged.scan.drift;
  const bool weighted = scene.particles.has_weights;
  std::vector<std::uint64_t> change = std::move(staged.sums.count_change);
  if (!weighted && change.empty() && staged.sums.drifted > 0) {
    change = count_changes(scene, drift);
    context.comm.all_sum(change);
  }
  Edits& edits = staged.edits;
  if (weighted || staged.sums.drifted > 0 || edits.any()) scene.told_loads.reset();
  const bool same_weights = weighted && !staged.arrays.has_weights && !edits.any();
  if (same_weights && staged.sums.drifted > 0)
    scene.loads = partition::moved_loads(context.comm, scene.particles.view(), scene.loads, scene.part.span(),
                                         drift.slot.span(), drift.part.span(), scene.options.part_sizes);
  for (std::size_t k = 0; k < drift.count(); ++k) std::swap(scene.part[drift.slot[k]], drift.part[k]);
  if (edits.any()) apply_edits(context.comm, scene, edits, drift);
  if (!weighted && change.empty() && edits.any()) change.resize(scene.loads.counts.size());
  if (!weighted) {
    for (std::size_t p = 0; p < edits.inserted_counts.size(); ++p) change[p] += edits.inserted_counts[p];
    for (const std::int32_t part : edits.removed_parts) --change[static_cast<std::size_t>(part)];
  }
  if (same_weights) return;
  if (weighted) {
    scene.loads = partition::summarise_loads(context.comm, scene.particles.view(), scene.part.span(),
                                             scene.options.part_sizes, scene.options.parts);
  } else if (staged.sums.drifted > 0 || edits.any()) {
    std::vector<std::uint64_t> counts = std::move(scene.loads.counts);
    for (std::size_t p = 0; p < counts.size(); ++p) counts[p] += change[p];
    scene.loads = partition::summarise_counts(std::move(counts), scene.options.part_sizes);
  }
}

// Returns whether new cuts were searched in vain.
bool later_step(Context& context, Scene& scene, Staged& staged, const PushRequest& push, Moves& moves,
                StepReport& report) {
  take_positions(scene, staged, push.moved);
  take_drift(context, scene, staged);
  report.inserted = staged.edits.inserted;
  report.removed = staged.edits.removed;
  report.first_id = staged.edits.first_id;
  report.drifted = staged.sums.drifted;
  const double error_before = scene.loads.error;
  report.error_before = error_before;
  // Cuts made without particles divide nothing, so they are searched anew, whatever the policy.
  const Decision decision = push.n == 0 && scene.n > 0 ? Decision{true, "the scene had no particles before"}
                                                       : decide_step(scene.options, scene.loads, push.terms);
  report.reason = decision.reason;
  const double start = context.clock.seconds();
  bool wasted = false;
  if (decision.search)
    wasted = !try_repartition(context, scene, staged, decision, error_before, moves, report);
  else if (context.no_skip.search)
    search(context, scene, staged, report);
  report.seconds.search = context.clock.seconds() - start;
  return wasted;
}

}  // namespace

partition::PartitionOptions search_options(const SceneOptions& options) {
  partition::PartitionOptions search;
  search.method = options.method;
  search.parts = options.parts;
  search.part_sizes = options.part_sizes;
  search.cut_tolerance = options.cut_tolerance;
  return search;
}

std::uint64_t count_differences(std::span<const std::int32_t> a, std::span<const std::int32_t> b) {
  RCB_CHECK(a.size() == b.size(), "assignments of different length");
  std::uint64_t count = 0;
  for (std::size_t i = 0; i < a.size(); ++i) count += static_cast<std::uint64_t>(a[i] != b[i]);
  return count;
}

void adopt(Scene& scene, NewCuts found, partition::LoadSummary loads) {
  scene.search_rounds = found.rounds;
  scene.search_reductions = found.reductions;
  scene.tree = std::move(found.tree);
  scene.tree_hash.reset();
  scene.known_cuts.reset();
  scene.told_tree.reset();
  scene.loads = std::move(loads);
  scene.told_loads.reset();
  ++scene.epoch;
}

scene::Held held_of(const Context& context, Scene& scene) {
  if (!scene.told_loads && scene.pushed) scene.told_loads = std::make_shared<const partition::LoadSummary>(scene.loads);
  if (!scene.told_tree && scene.pushed) scene.told_tree = std::make_shared<const cuts::CutTree>(scene.tree);
  scene::Held held{.n = scene.n,
                   .weights = scene.particles.has_weights,
                   .ids = scene.ids,
                   .epoch = scene.epoch,
                   .hash = scene.pushed ? scene.cuts_hash() : 0,
                   .tree = scene.told_tree,
                   .loads = scene.told_loads,
                   .plan_version = scene.plan_version,
                   .plan_checksum = scene.plan_checksum,
                   .rank_counts = {},
                   .id_next = scene.id_next,
                   .search_rounds = scene.search_rounds,
                   .search_reductions = scene.search_reductions};
  for (int r = 0; r < context.comm.size(); ++r)
    held.rank_counts.push_back(held_by(scene, scene.n, r, context.comm.size()));
  return held;
}

Response refill(Context& context, Scene& scene, Staged& staged, const PushRequest& push) {
  scene.particles = std::move(staged.arrays);
  scene.ids = staged.ids;
  const particles::ParticleView view = scene.particles.view();
  const cuts::Positions positions = cuts::Positions::axes(
      std::span<const double* const>(view.position.data(), static_cast<std::size_t>(scene.options.dims)), view.count);
  scene.part.resize(view.count);
  const Status found = scene.snapshot().owner(positions, {.ids = scene.particles.id.span()}, scene.part.span());
  RCB_CHECK(found.ok(), found.message());  // the values were checked
  scene.loads =
      partition::summarise_loads(context.comm, view, scene.part.span(), scene.options.part_sizes, scene.options.parts);
  scene.told_loads.reset();
  scene.pushed = true;
  scene.step = push.id.step;
  migrate(context.comm, scene, true);
  give_back(context, scene, push, staged);
  Response response =
      done({{"refilled", true},
            {"plan", {{"version", scene.plan_version}, {"checksum", wire::hex64(scene.plan_checksum)}}}});
  if (context.root()) response.change = {scene.name, scene::Refilled{held_of(context, scene)}};
  return response;
}

scene::Stepped commit(Context& context, Scene& scene, Staged& staged, const PushRequest& push, PartChanges* changes) {
  const double start = context.clock.seconds();
  const bool first = !scene.pushed;
  scene::Stepped stepped;
  StepReport& report = stepped.report;
  report.scene = scene.name;
  report.step = push.id.step;
  report.positions_step = push.id.step;
  report.bytes = staged.bytes;
  report.way = push.way;
  report.scanned = push.moving();
  report.seconds.receive = staged.seconds;

  Moves moves;
  if (first) {
    first_step(context, scene, staged, report);
  } else {
    stepped.wasted = later_step(context, scene, staged, push, moves, report);
  }
  report.n = scene.n;
  report.parts = scene.options.parts;
  report.epoch = scene.epoch;
  report.error = scene.loads.error;
  report.imbalance = scene.loads.imbalance;
  report.weights_as_zero = scene.loads.weights_as_zero;

  PartChanges mine;
  const Drift& drift = staged.scan.drift;
  const bool any = first || report.drifted > 0 || report.moved > 0;
  if (changes != nullptr && any && !first) mine = changes_of_step(scene, drift, moves);
  const auto tell = [&] {
    if (changes != nullptr && any)
      gather_changes(context.comm, mine, first ? scene.n : report.drifted + report.moved, *changes);
  };
  // A short list of changes goes to rank 0 before the particles travel: a rank need not wait until it has arrived, and
  // goes on to send particles. A long list goes afterwards, when there is memory for it.
  const bool few = !first && report.drifted + report.moved <= ExchangeLimits().few;
  if (few) tell();
  const double migrating = context.clock.seconds();
  std::uint64_t changed_rank = 0;
  if (first) {
    changed_rank = migrate(context.comm, scene, true);
  } else if (report.moved > 0) {
    std::vector<std::uint64_t> touched;
    touched.reserve(drift.count() + moves.slot.size());
    for_each_touched(drift, moves, [&touched](std::uint64_t slot, std::int32_t) { touched.push_back(slot); });
    staged.scan.drift = {};  // frees its memory for the migration
    moves = {};
    changed_rank = migrate_touched(context.comm, scene, std::move(touched));
  } else if (staged.sums.migrating > 0 || context.no_skip.exchange) {
    changed_rank = migrate_drifted(context.comm, scene, drift, staged.sums);
  }
  (report.repartitioned ? report.seconds.migrate : report.seconds.exchange) = context.clock.seconds() - migrating;
  report.migrated = first ? 0 : changed_rank;
  if (changes != nullptr && first) mine = all_changes(scene);
  if (!few) tell();

  note_skips(scene, push, context.no_skip, report);
  report.seconds.total = staged.seconds + context.clock.seconds() - start;
  scene.step = push.id.step;
  if (!context.root()) return stepped;
  stepped.session = push.id.session;
  stepped.step_seconds = push.step_seconds;
  stepped.drifted = push.drifted;
  stepped.held = held_of(context, scene);
  return stepped;
}

}  // namespace rcb::service
