#include "server/service/step/step.hpp"

#include <algorithm>
#include <array>
#include <random>
#include <utility>

#include "common/cuts/id_sum.hpp"
#include "common/layout/layout.hpp"
#include "common/partition/repartition.hpp"
#include "server/service/context/collective.hpp"
#include "server/service/step/exchange.hpp"

namespace rcb::service {
namespace {

using scene::Decision;
using scene::Skip;

void note_skips(const Scene& scene, const PushRequest& push, bool exchanged, StepReport& report) {
  const auto is_float32 = [](const Block& block) { return block.is_float32; };
  if (scene.options.dims < 3) report.skipped.add(Skip::dimension);
  if (!scene.particles.has_weights) report.skipped.add(Skip::weights);
  if (!scene.ids) report.skipped.add(Skip::ids);
  if (!push.blocks.empty() && std::ranges::all_of(push.blocks, is_float32)) report.skipped.add(Skip::double_precision);
  if (!exchanged) report.skipped.add(Skip::exchange);
  if (report.reductions == 0) report.skipped.add(Skip::search);
  if (report.reductions > 0 && report.searched < scene.n) report.skipped.add(Skip::far_from_cuts);
}

void put(Scene& scene, partition::LoadSummary loads) {
  scene.loads = std::make_shared<const partition::LoadSummary>(std::move(loads));
}

// Swaps in a new set of particles. Collective.
void take_set(Context& context, Scene& scene, Staged& staged) {
  std::swap(scene.particles, staged.arrays);
  scene.n = staged.n;
  scene.ids = staged.ids;
  scene.weights = scene.particles.has_weights;
  if (staged.same) return;
  scene.id_sum = staged.sums.id_sum;
  const std::uint64_t key = secret(context.comm);
  scene.key = {key, cuts::sum_ids(scene.particles.id.span(), key).any_order};
  context.comm.all_sum({&scene.key.sum, 1});
}

void first_step(Context& context, Scene& scene, Staged& staged, StepReport& report) {
  take_set(context, scene, staged);
  const double start = context.clock.seconds();
  auto found = partition::partition(context.comm, scene.particles.view(), search_options(scene.options));
  RCB_CHECK(found.ok(), found.status().message());  // the options were checked when the scene was made
  report.searched = found->cost.searched;
  report.rounds = found->cost.rounds;
  report.reductions = found->cost.reductions;
  scene.part = std::move(found->part);
  auto loads = found->counts.empty()
                   ? partition::summarise_loads(context.comm, scene.particles.view(), scene.part.span(),
                                                scene.options.part_sizes, scene.options.parts)
                   : partition::summarise_counts(std::move(found->counts), scene.options.part_sizes);
  adopt(scene, {std::move(found->tree), found->cost.rounds, found->cost.reductions}, std::move(loads));
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
  options.partition.previous = scene.tree.get();
  options.incremental = !context.options.no_skip.full_search && scene.full_searches_left == 0;
  options.before_search_of_all = [&staged] {
    for (auto& axis : staged.arrays.position) axis.release();  // a full search needs as much memory
  };
  partition::Repartition found = partition::repartition(
      context.comm, scene.particles.view(), options, {*scene.tree, scene.part.span(), *scene.loads, staged.ranges()});
  // After a wasted incremental search the next 1, 3, then kFullSearchesMax repartitions search all particles.
  if (options.incremental)
    scene.full_searches_left = scene.full_searches_last =
        found.wasted ? std::min(2 * scene.full_searches_last + 1, kFullSearchesMax) : 0;
  else if (scene.full_searches_left > 0)
    --scene.full_searches_left;
  report.searched = found.cost.searched;
  report.rounds = found.cost.rounds;
  report.reductions = found.cost.reductions;
  return found;
}

// Searches new cuts and adopts them if they lower the error; returns whether it did. Collective.
bool try_repartition(Context& context, Scene& scene, Staged& staged, const Decision& decision, double error_before,
                     StepReport& report) {
  partition::Repartition found = search(context, scene, staged, report);
  if (may_be_wasted(scene.options, *scene.loads) && !(found.loads.error < error_before)) {
    report.reason = reason_not_adopted(decision, found.loads.error);
    return false;
  }
  report.repartitioned = true;
  report.reason = reason_adopted(decision, found.loads.error);
  report.axes_flipped = cuts::axes_flipped(*scene.tree, found.tree);
  std::array<std::uint64_t, 2> changed{found.delta.slot.size(), 0};  // part, and rank too
  const auto rank_of = [&](std::int32_t part) {
    return layout::rank_of_part(part, scene.options.parts, context.comm.size());
  };
  for (std::size_t k = 0; k < found.delta.slot.size(); ++k) {
    std::int32_t& part = scene.part[found.delta.slot[k]];
    changed[1] += rank_of(part) != rank_of(found.delta.part[k]) ? 1U : 0U;
    part = found.delta.part[k];
  }
  context.comm.all_sum(changed);
  report.moved = changed[0];
  report.migrated = changed[1];
  adopt(scene, {std::move(found.tree), found.cost.rounds, found.cost.reductions}, std::move(found.loads));
  return true;
}

// Held particles: puts the parts that the scan found in force, and updates the loads. Collective.
void take_drift(Context& context, Scene& scene, Staged& staged) {
  for (std::size_t a = 0; a < static_cast<std::size_t>(scene.options.dims); ++a)
    scene.particles.position[a].swap(staged.arrays.position[a]);
  const Drift& drift = staged.scan.drift;
  const bool weighted = scene.particles.has_weights;
  const bool new_weights = staged.arrays.has_weights;
  if (new_weights) scene.particles.weight.swap(staged.arrays.weight);
  if (staged.sums.drifted == 0 && !new_weights) return;
  std::vector<std::uint64_t> change = std::move(staged.sums.counts);
  if (!weighted && change.empty()) {
    change = count_changes(scene, drift);
    context.comm.all_sum(change);
  }
  for (std::size_t k = 0; k < drift.count(); ++k) scene.part[drift.slot[k]] = drift.part[k];
  if (weighted) {
    put(scene, partition::summarise_loads(context.comm, scene.particles.view(), scene.part.span(),
                                          scene.options.part_sizes, scene.options.parts));
    return;
  }
  std::vector<std::uint64_t> counts = scene.loads->counts;
  for (std::size_t p = 0; p < counts.size(); ++p) counts[p] += change[p];
  put(scene, partition::summarise_counts(std::move(counts), scene.options.part_sizes));
}

// A new set of particles with their parts. Collective.
void take_rows(Context& context, Scene& scene, Staged& staged) {
  take_set(context, scene, staged);
  scene.part.swap(staged.part);
  put(scene, staged.sums.counts.empty()
                 ? partition::summarise_loads(context.comm, scene.particles.view(), scene.part.span(),
                                              scene.options.part_sizes, scene.options.parts)
                 : partition::summarise_counts(std::move(staged.sums.counts), scene.options.part_sizes));
}

// Returns whether new cuts were searched in vain.
bool later_step(Context& context, Scene& scene, Staged& staged, const PushRequest& push, StepReport& report) {
  const bool was_empty = scene.n == 0;
  staged.held ? take_drift(context, scene, staged) : take_rows(context, scene, staged);
  report.inserted = push.inserted;
  report.removed = push.removed;
  report.strangers = staged.sums.strangers;
  report.drifted_known = staged.held || push.drifted.has_value();
  report.drifted = staged.held ? staged.sums.drifted : push.drifted.value_or(0);
  const bool full_change = is_full_change(staged.sums.exported, scene.n);
  if (full_change) staged.arrays = {};  // it needs memory itself
  const double error_before = scene.loads->error;
  report.error_before = error_before;
  // Cuts made without particles divide nothing, so they are searched anew, whatever the policy.
  const Decision decision = was_empty && scene.n > 0 ? Decision{true, "the scene had no particles before"}
                                                     : decide_step(scene.options, *scene.loads, push.terms);
  report.reason = decision.reason;
  // An incremental search pays where nearly all particles are on the ranks that own their parts.
  if (decision.search && full_change) {
    send_exports(context.comm, scene, std::exchange(staged.exports, {}), staged.sums.exported, staged.sums.from_to);
    staged.sums.exported = 0;
    staged.scan.ranges = {};
  }
  const double start = context.clock.seconds();
  bool wasted = false;
  if (decision.search)
    wasted = !try_repartition(context, scene, staged, decision, error_before, report);
  else if (context.options.no_skip.search)
    search(context, scene, staged, report);
  report.seconds.search = context.clock.seconds() - start;
  return wasted;
}

// Sends all particles to the ranks that own them; returns whether any has gone. Collective.
bool migrate(Context& context, Scene& scene, Staged& staged, bool first, StepReport& report) {
  const double start = context.clock.seconds();
  std::uint64_t sent = staged.sums.exported;
  if (first || report.moved > 0) {
    staged.exports = {};
    sent = send_strangers(context.comm, scene, first);
  } else if (sent > 0) {
    send_exports(context.comm, scene, std::move(staged.exports), sent, staged.sums.from_to);
  } else if (context.options.no_skip.exchange) {  // of nothing, for measurement
    const auto ranks = static_cast<std::size_t>(context.comm.size());
    context.comm.exchange(std::vector<std::span<const std::byte>>(ranks), std::vector<std::span<std::byte>>(ranks));
  }
  (report.repartitioned ? report.seconds.migrate : report.seconds.exchange) = context.clock.seconds() - start;
  return sent > 0 || (context.options.no_skip.exchange && !first);
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

void adopt(Scene& scene, NewCuts found, partition::LoadSummary loads) {
  scene.search_rounds = found.rounds;
  scene.search_reductions = found.reductions;
  scene.hash = found.tree.hash();
  scene.tree = std::make_shared<const cuts::CutTree>(std::move(found.tree));
  scene.known_cuts.reset();
  put(scene, std::move(loads));
  ++scene.epoch;
}

scene::Stepped commit(Context& context, Scene& scene, Staged& staged, const PushRequest& push) {
  const double start = context.clock.seconds();
  const bool first = scene.epoch == 0;
  scene::Stepped stepped;
  StepReport& report = stepped.report;
  report.scene = scene.name;
  report.step = push.id.step;
  report.positions_step = push.id.step;
  report.bytes = staged.bytes;
  report.way = push.way;
  report.scanned = push.n;
  report.seconds.receive = staged.seconds;

  if (first)
    first_step(context, scene, staged, report);
  else
    stepped.wasted = later_step(context, scene, staged, push, report);
  report.n = scene.n;
  report.parts = scene.options.parts;
  report.epoch = scene.epoch;
  report.error = scene.loads->error;
  report.imbalance = scene.loads->imbalance;
  report.weights_as_zero = scene.loads->weights_as_zero;
  staged.scan = {};  // frees its memory for the migration
  const bool exchanged = migrate(context, scene, staged, first, report);
  note_skips(scene, push, exchanged, report);
  report.seconds.total = staged.seconds + context.clock.seconds() - start;
  scene.step = push.id.step;
  if (!context.root()) return stepped;
  stepped.step_seconds = push.step_seconds;
  stepped.drifted = push.drifted;
  stepped.held = scene;
  return stepped;
}

}  // namespace rcb::service
