#include "common/partition/sample/guide.hpp"

#include <algorithm>
#include <bit>
#include <utility>

#include "common/base/cpu.hpp"
#include "common/base/index.hpp"
#include "common/base/random.hpp"
#include "common/comm/gather.hpp"
#include "common/partition/balance/load.hpp"
#include "common/partition/rules/split_rule.hpp"
#include "common/partition/sample/outermost.hpp"

namespace rcb::partition {
namespace {

// Sampled coordinates that choose a map: of a large set; of a small one, all ranks together and at least and at most of
// one rank.
constexpr std::size_t kPlannedMax = 1024;
constexpr std::size_t kPlannedOfAll = 4096;
constexpr std::size_t kPlannedOfRankMin = 4;
constexpr std::size_t kPlannedOfRankMax = 256;
// Under a cut tolerance: one of so many ids.
constexpr std::uint64_t kIdsPlanned = 64;

// The upper cuts of a sample that is cut as the search cuts the set.
Splitters splitters_of(SortedSample sample, const PartitionOptions& options) {
  Splitters splitters;
  splitters.rounded = sample.rounded();
  SplitRule rule(options, sample.sample().dims);
  rule.set_all(sample.all().size(), sample.extents(sample.all()));
  cut_sample(sample, {0, 0, options.parts}, 0, sample.all(),
             [&](const NodeRange& range, std::size_t heap, const SortedSample::Range& own) {
               if (heap >= Splitters::kNodes) return std::optional<SampledCut>();
               const Point extents = sample.extents(own);
               const int axis = (*rule.axes_of(range, {extents, extents}))[0];
               const SampledCut cut = SampledCut::at_share(axis, rule.left_share(range), own.size());
               const auto [least, most] = bracket_of(sample, own, cut, options.tuning);
               splitters.nodes[heap] = {least, most, cut.axis};
               return std::optional(cut);
             });
  return splitters;
}

// Within a cut tolerance cuts lie between a map's integers, so the tree depends on the map: what chooses it must then
// be the same however the particles are distributed, hence some ids, chosen by a hash.
std::vector<std::size_t> planning_slots(const particles::ParticleView& particles, bool by_id, int ranks) {
  if (!by_id) {
    const std::size_t most = std::clamp(kPlannedOfAll / at(ranks), kPlannedOfRankMin, kPlannedOfRankMax);
    return sampled_slots(particles.count, std::max<std::size_t>((particles.count + most - 1) / most, 1));
  }
  std::vector<std::size_t> slots;
  for (std::size_t i = 0; i < particles.count; ++i)
    if (mix64(static_cast<std::uint64_t>(particles.id_of(i))) % kIdsPlanned == 0) slots.push_back(i);
  return slots;
}

}  // namespace

AxisMaps Guide::maps(int dims) const {
  constexpr unsigned kZerosMax = 30;
  AxisMaps maps;
  for (std::size_t a = 0; a < at(dims); ++a) maps[a] = axes[a].map();
  for (std::size_t a = 0; a < at(dims) && all_linear(maps, dims); ++a)
    if (axes[a].maybe_lossless) maps[a].set_lossless(kZerosMax);
  return maps;
}

AxisPlans plan_axes(const SortedSample& sample) {
  AxisPlans plans;
  const geometry::Box box = sample.box(sample.all());
  const std::size_t stride = sample.all().size() / kPlannedMax + 1;
  for (std::size_t a = 0; a < at(sample.sample().dims); ++a) {
    std::vector<double> some;
    for (std::size_t k = 0; k < sample.all().size(); k += stride) some.push_back(sample.sample().x(a, k));
    plans[a] = plan_sampled_axis(box.lo[a], box.hi[a], some);
  }
  return plans;
}

// Within a cut tolerance the cuts depend on where a search begins. Buckets need weights on no rank, and on every rank
// the vector instructions that sort particles into them.
std::optional<Guide> guide_of_large_set(comm::Comm& comm, const particles::ParticleView& particles,
                                        const PartitionOptions& options, SearchCost& cost) {
  const SampleTuning& tuning = options.tuning.sample;
  if (options.parts < tuning.parts_min || options.cut_tolerance > 0) return std::nullopt;
  std::array<std::uint64_t, 2> sums{particles.count, particles.weight != nullptr || !has_avx2() ? 1U : 0U};
  comm.all_sum(sums);
  ++cost.reductions;
  const auto [count, unfit] = sums;
  const std::uint64_t per_rank = count / static_cast<std::uint64_t>(comm.size());
  const std::uint64_t per_part = per_rank / static_cast<std::uint64_t>(options.parts);
  if (unfit > 0 || per_rank < tuning.count_min || per_part < tuning.per_part_min) return std::nullopt;
  const std::uint64_t wanted = std::clamp(count / tuning.stride, tuning.sample_min, tuning.sample_max);
  const std::uint64_t stride = std::max<std::uint64_t>(count / std::max<std::uint64_t>(wanted, 1), 1);
  const Sample sample = gather_sample(comm, particles, sampled_slots(particles.count, stride));
  SortedSample sorted(sample);
  gather_outermost_if_open(comm, particles, options, stride, sorted, cost);
  Guide guide;
  if (comm.rank() == 0) {
    guide.axes = plan_axes(sorted);
    guide.splitters = splitters_of(std::move(sorted), options);
    guide.split = true;
  }
  cost.reductions += 2;
  return comm::values_of_first<Guide>(comm, {&guide, 1})[0];
}

SmallSet look_at_small_set(comm::Comm& comm, const particles::ParticleView& particles, const PartitionOptions& options,
                           SearchCost& cost) {
  const std::size_t dims = at(particles.dims);
  const bool by_id = options.cut_tolerance > 0;
  const std::vector<std::size_t> slots = planning_slots(particles, by_id, comm.size());
  // A rank's message: the number of its particles and the range of their weights; of each axis the least coordinate,
  // the greatest and those sampled. Of ids these may be many: they stay where they are, and what they tell is added up.
  constexpr std::size_t kHead = 3;
  std::array<std::vector<double>, geometry::kDimsMax> sampled;
  const particles::Range weights = weight_range(particles);
  std::vector<double> mine{std::bit_cast<double>(std::uint64_t{particles.count}), weights.lo, weights.hi};
  for (std::size_t a = 0; a < dims; ++a) {
    const double* const x = particles.position[a];
    geometry::Box own;
    geometry::least_and_most({x, particles.count}, own.lo[a], own.hi[a]);
    mine.insert(mine.end(), {own.lo[a], own.hi[a]});
    for (const std::size_t slot : slots) (by_id ? sampled[a] : mine).push_back(x[slot]);
  }
  const comm::Gathered<double> told = comm::all_gather_values<double>(comm, mine);
  SmallSet all;
  const double* next = told.values.begin();
  for (const std::size_t words : told.counts) {
    all.count += std::bit_cast<std::uint64_t>(next[0]);
    all.weights.extend({next[1], next[2]});
    next += kHead;
    for (std::size_t a = 0; a < dims; ++a) {
      const double* const end = next + (words - kHead) / dims;
      all.box.lo[a] = std::min(all.box.lo[a], next[0]);
      all.box.hi[a] = std::max(all.box.hi[a], next[1]);
      sampled[a].insert(sampled[a].end(), next + 2, end);
      next = end;
    }
  }
  std::array<MapTrial, geometry::kDimsMax> trials;
  for (std::size_t a = 0; a < dims && all.count > 0; ++a) trials[a].add(all.box.lo[a], all.box.hi[a], sampled[a]);
  if (by_id) comm.all_sum({trials[0].by_value.data(), sizeof(trials) / sizeof(std::uint64_t)});
  for (std::size_t a = 0; a < dims; ++a) all.guide.axes[a] = plan_axis(all.box.lo[a], all.box.hi[a], trials[a]);
  cost.reductions += by_id ? 2 : 1;
  cost.reads += particles.count;
  cost.bytes += particles.count * dims * sizeof(double);
  return all;
}

}  // namespace rcb::partition
