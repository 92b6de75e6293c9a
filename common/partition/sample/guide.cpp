#include "common/partition/sample/guide.hpp"

#include <algorithm>
#include <cmath>

#include "common/base/cpu.hpp"
#include "common/base/index.hpp"
#include "common/base/random.hpp"
#include "common/comm/gather.hpp"
#include "common/partition/balance/load.hpp"
#include "common/partition/rules/split_rule.hpp"

namespace rcb::partition {
namespace {

constexpr std::uint64_t kMapSampleOfAll = 4096;  // sampled coordinates that choose a small set's maps
constexpr std::size_t kMapSampleMax = 1024;      // and a sample's

// Within a cut tolerance the cuts depend on where a search begins. Splitters need weights on no rank, and on every rank
// the vector instructions that sort particles into buckets.
bool worth_splitters(const PartitionOptions& options, std::uint64_t count, std::uint64_t unfit, int ranks) {
  const SampleTuning& tuning = options.tuning.sample;
  const std::uint64_t per_rank = count / static_cast<std::uint64_t>(ranks);
  return options.parts >= tuning.parts_min && options.cut_tolerance == 0 && unfit == 0 &&
         per_rank >= std::max(tuning.count_min, tuning.per_part_min * static_cast<std::uint64_t>(options.parts));
}

// The upper cuts of a sample that is cut as the search cuts the set.
void find_splitters(Sample sample, const PartitionOptions& options, int dims, Splitters& splitters) {
  SplitRule rule(options, dims);
  const auto extents_of = [dims](Sample own) { return box_of(own, dims).extents(dims); };
  rule.set_all(sample.size(), extents_of(sample));
  cut_sample(
      sample, {0, 0, options.parts}, 0, options.tuning,
      [&](const NodeRange& range, std::size_t heap, Sample own) -> std::optional<SampledCut> {
        if (heap >= Splitters::kNodes) return std::nullopt;
        const Point extents = extents_of(own);
        const auto n = static_cast<double>(own.size());
        const double share = rule.left_share(range);
        return SampledCut{*rule.axes_of(range, {extents, extents}), share * n, std::sqrt(share * (1 - share) * n)};
      },
      [&](const NodeRange&, std::size_t heap, std::int32_t axis, const Bracket& bracket) {
        if (heap < Splitters::kNodes) splitters.nodes[heap] = {bracket.least, bracket.most, axis};
      });
}

// Within a cut tolerance cuts lie between a map's integers, so the tree depends on the map: what chooses it must then
// be the same however the particles are distributed, hence some ids, chosen by a hash.
std::vector<std::size_t> map_sample_slots(const particles::ParticleView& particles, bool by_id, std::uint64_t count) {
  const std::uint64_t stride = count / kMapSampleOfAll + 1;
  if (!by_id) return sampled_slots(particles.count, stride);
  std::vector<std::size_t> slots;
  for (std::size_t i = 0; i < particles.count; ++i)
    if (mix64(static_cast<std::uint64_t>(particles.id_of(i))) % stride == 0) slots.push_back(i);
  return slots;
}

void look_at_all(comm::Comm& comm, const particles::ParticleView& particles, bool by_id, SetGuide& all) {
  // A rank's message: the range of its weights; of each axis the least coordinate, the greatest and those sampled.
  const std::size_t dims = at(particles.dims);
  const std::vector<std::size_t> slots = map_sample_slots(particles, by_id, all.count);
  const particles::Range weights = weight_range(particles);
  std::vector<double> mine{weights.lo, weights.hi};
  for (std::size_t a = 0; a < dims; ++a) {
    const double* const x = particles.position[a];
    geometry::Box own;
    geometry::least_and_most({x, particles.count}, own.lo[a], own.hi[a]);
    mine.insert(mine.end(), {own.lo[a], own.hi[a]});
    for (const std::size_t slot : slots) mine.push_back(x[slot]);
  }
  const comm::Gathered<double> told = comm::all_gather_values<double>(comm, mine);
  std::array<std::vector<double>, geometry::kDimsMax> sampled;
  const double* next = told.values.begin();
  for (const std::size_t words : told.counts) {
    all.weights.extend({next[0], next[1]});
    next += 2;
    for (std::size_t a = 0; a < dims; ++a) {
      const double* const end = next + (words - 2) / dims;
      all.box.lo[a] = std::min(all.box.lo[a], next[0]);
      all.box.hi[a] = std::max(all.box.hi[a], next[1]);
      sampled[a].insert(sampled[a].end(), next + 2, end);
      next = end;
    }
  }
  for (std::size_t a = 0; a < dims; ++a) all.guide.axes[a] = plan_axis(all.box.lo[a], all.box.hi[a], sampled[a]);
}

}  // namespace

Guide Guide::of_sample(Sample sample, const geometry::Box& box, int dims) {
  Guide guide{.split = true};
  for (std::size_t a = 0; a < at(dims); ++a) {
    std::vector<double> some;
    for (std::size_t k = 0; k < sample.size(); k += sample.size() / kMapSampleMax + 1) some.push_back(sample[k].x[a]);
    guide.axes[a] = plan_sampled_axis(box.lo[a], box.hi[a], some);
    guide.splitters.rounded.fit(a, box.lo[a], box.hi[a]);
  }
  return guide;
}

AxisMaps Guide::maps(int dims) const {
  constexpr unsigned kZerosMax = 30;
  AxisMaps maps;
  for (std::size_t a = 0; a < at(dims); ++a) maps[a] = axes[a].map();
  for (std::size_t a = 0; a < at(dims) && all_linear(maps, dims); ++a)
    if (axes[a].maybe_lossless) maps[a].set_lossless(kZerosMax);
  return maps;
}

SetGuide guide_of_set(comm::Comm& comm, const particles::ParticleView& particles, const PartitionOptions& options,
                      SearchCost& cost) {
  std::array<std::uint64_t, 2> sums{particles.count, particles.weight != nullptr || !has_avx2() ? 1U : 0U};
  comm.all_sum(sums);
  SetGuide all{.count = sums[0]};
  cost.reductions += 2;
  if (!worth_splitters(options, all.count, sums[1], comm.size())) {
    look_at_all(comm, particles, options.cut_tolerance > 0, all);
    cost.reads += particles.count;
    cost.bytes += particles.count * at(particles.dims) * sizeof(double);
    return all;
  }
  const SampleTuning& tuning = options.tuning.sample;
  const std::uint64_t wanted = std::clamp(all.count / tuning.stride, tuning.sample_min, tuning.sample_max);
  const std::uint64_t stride = std::max<std::uint64_t>(all.count / std::max<std::uint64_t>(wanted, 1), 1);
  Buffer<SampledParticle> sample = gather_sample(comm, particles, sampled_slots(particles.count, stride));
  if (comm.rank() == 0) {
    all.guide = Guide::of_sample(sample.span(), box_of(sample.span(), particles.dims), particles.dims);
    find_splitters(sample.span(), options, particles.dims, all.guide.splitters);
  }
  all.guide = comm::values_of_first<Guide>(comm, {&all.guide, 1})[0];
  ++cost.reductions;
  return all;
}

}  // namespace rcb::partition
