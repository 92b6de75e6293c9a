#include "common/partition/search_all.hpp"

#include <algorithm>

#include "common/base/index.hpp"
#include "common/comm/wide_sum.hpp"
#include "common/partition/buckets/pass.hpp"
#include "common/partition/buckets/put.hpp"
#include "common/partition/search/tree_search.hpp"

namespace rcb::partition {
namespace {

void sum_counts(comm::Comm& comm, const OwnShare& own, std::span<Bucket> buckets, SearchCost& cost) {
  std::vector<std::uint64_t> counts;
  for (std::size_t b = 0; b < buckets.size(); ++b)
    if (buckets[b].exists()) counts.push_back(own.loads[b].count);
  comm.all_sum(counts);
  ++cost.reductions;
  auto next = counts.begin();
  for (Bucket& bucket : buckets)
    if (bucket.exists()) cost.searched += bucket.load.count = *next++;
}

// What is known of a small set, all of whose particles are in one bucket. Returns the scale of the weights, if they
// count. Collective with weights (one sum).
std::optional<ExactScale> note_all(comm::Comm& comm, const particles::ParticleView& particles, const SmallSet& all,
                                   Bucket& bucket, SearchCost& cost) {
  bucket.box = all.box;
  bucket.load.count = cost.searched = all.count;
  const std::optional<double> greatest = greatest_weight(all.weights);
  if (!greatest) return std::nullopt;
  const ExactScale scale(*greatest, all.count);
  for (std::size_t i = 0; i < particles.count; ++i) bucket.load.weight += scale(particles.weight[i]);
  cost.bytes += particles.count * sizeof(double);
  comm::all_sum_wide(comm, {&bucket.load.weight, 1});
  ++cost.reductions;
  return scale;
}

}  // namespace

std::optional<PartitionResult> search_all(comm::Comm& comm, const particles::ParticleView& particles,
                                          const PartitionOptions& options, const comm::GoOn& go_on) {
  PartitionResult result;
  if (options.parts == 1) {
    result.tree = uncut_tree(options, particles.dims);
    result.part.resize(particles.count);
    std::ranges::fill(result.part.span(), 0);
    return result;
  }
  const std::optional<Guide> large = guide_of_large_set(comm, particles, options, result.cost);
  const SmallSet small = large ? SmallSet{} : look_at_small_set(comm, particles, options, result.cost);
  const Guide& guide = large ? *large : small.guide;
  if (go_on && !go_on()) return std::nullopt;
  AxisMaps maps = guide.maps(particles.dims);
  std::vector<Bucket> buckets = empty_buckets(options.parts, guide.split, false);
  PointStore points(buckets.size(), points_together(particles.count, guide.split ? buckets.size() : 1, options.tuning));
  const OwnShare own = put_all(particles, guide, maps, options.tuning, points);
  std::optional<ExactScale> scale;
  if (large) {
    reduce_boxes(comm, own, buckets, result.cost);
    sum_counts(comm, own, buckets, result.cost);
  } else {
    scale = note_all(comm, particles, small, buckets[0], result.cost);
  }
  note_boxes(buckets, maps, particles.dims);
  if (may_be_lossless(maps, particles.dims)) reduce_lossless(comm, own.lossless, maps, particles.dims, result.cost);
  result.cost.reads += particles.count;
  result.cost.bytes += particles.count * at(particles.dims) * sizeof(double);
  result.part.resize(particles.count);
  const SearchStart start{buckets, maps, scale, points, {}};
  auto found = TreeSearch(comm, particles, options, start, result.cost).find(go_on);
  if (!found) return std::nullopt;
  constexpr std::size_t kAhead = 16;  // the processor can't tell which come next
  for (const PointsOfPart& some : found->points) {
    std::int32_t* const part = result.part.data() + some.base;
    for (std::size_t k = 0; k < some.points.size(); ++k) {
      if (k + kAhead < some.points.size()) __builtin_prefetch(part + some.points[k + kAhead].index, 1);
      part[some.points[k].index] = some.part;
    }
    result.cost.bytes += some.points.size() * (2 * sizeof(QuantisedPoint) + sizeof(std::int32_t));
  }
  result.tree = std::move(found->tree);
  result.counts = std::move(found->counts);
  return result;
}

}  // namespace rcb::partition
