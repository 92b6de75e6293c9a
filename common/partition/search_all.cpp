#include "common/partition/search_all.hpp"

#include <algorithm>

#include "common/base/index.hpp"
#include "common/comm/wide_sum.hpp"
#include "common/partition/buckets/pass.hpp"
#include "common/partition/sample/guide.hpp"
#include "common/partition/search/tree_search.hpp"

namespace rcb::partition {
namespace {

// The pass: makes the points of all particles, bucket by bucket; part[i] becomes the bucket of particle i. Without
// splitters all are in bucket 0, and neither its box nor its load is told. Local.
OwnShare put_all(const particles::ParticleView& particles, const Guide& guide, const AxisMaps& maps,
                 const Tuning& tuning, PointStore& points, std::span<std::int32_t> part) {
  OwnShare own(Splitters::kBuckets, particles.dims);
  const WalkTables tables(guide.splitters);
  const auto put = [&](const Axes& x, BucketsOfBlock& bucket) {
    kernels().walk(tables, x, bucket.data());
    own.grow(x, bucket.data(), kernels().outside_own(x, bucket.data(), own.boxes.data()));
  };
  BucketsOfBlock seeds{};
  Blocks some(particles);
  if (guide.split) for_seeds(particles.count, [&](std::size_t first) { put(some.read(first), seeds); });
  const auto choose = [&](std::size_t first, Blocks& blocks, BucketsOfBlock& bucket) {
    const Axes& x = blocks.read(first);
    if (guide.split) put(x, bucket);
    std::copy_n(bucket.begin(), std::min(kBlock, particles.count - first), part.data() + first);
    return ~std::uint64_t{0};
  };
  own.lossless = make_points(particles, maps, tuning, points, choose, [](auto&&...) {});
  for (std::size_t b = 0; b < own.loads.size(); ++b) own.loads[b].count = points.count(b);
  return own;
}

// Sets the load of a set without splitters, all of whose particles are in one bucket. Returns the scale of the weights,
// if they count. Collective with weights (one sum).
std::optional<ExactScale> weigh_all(comm::Comm& comm, const particles::ParticleView& particles, const SetGuide& all,
                                    Load& load, SearchCost& cost) {
  load.count = cost.searched = all.count;
  const std::optional<double> greatest = greatest_weight(all.weights);
  if (!greatest) return std::nullopt;
  const ExactScale scale(*greatest, all.count);
  for (std::size_t i = 0; i < particles.count; ++i) load.weight += scale(particles.weight[i]);
  cost.bytes += particles.count * sizeof(double);
  comm::all_sum_wide(comm, {&load.weight, 1});
  ++cost.reductions;
  return scale;
}

}  // namespace

std::optional<PartitionResult> search_all(comm::Comm& comm, const particles::ParticleView& particles,
                                          const PartitionOptions& options, const comm::GoOn& go_on) {
  PartitionResult result;
  result.part.resize(particles.count);
  if (options.parts == 1) {
    result.tree = uncut_tree(options, particles.dims);
    std::ranges::fill(result.part.span(), 0);
    return result;
  }
  const SetGuide all = guide_of_set(comm, particles, options, result.cost);
  const bool split = all.guide.split;
  if (go_on && !go_on()) return std::nullopt;
  AxisMaps maps = all.guide.maps(particles.dims);
  std::vector<Bucket> buckets = empty_buckets(options.parts, split, false);
  PointStore points(buckets.size(), points_together(particles.count, split ? buckets.size() : 1, options.tuning));
  const OwnShare own = put_all(particles, all.guide, maps, options.tuning, points, result.part.span());
  std::optional<ExactScale> scale;
  if (split) {
    reduce_boxes(comm, own, buckets, result.cost);
    sum_loads(comm, own, false, buckets, result.cost);
  } else {
    buckets[0].box = all.box;
    scale = weigh_all(comm, particles, all, buckets[0].load, result.cost);
  }
  note_boxes(buckets, maps, particles.dims);
  if (may_be_lossless(maps, particles.dims)) reduce_lossless(comm, own.lossless, maps, particles.dims, result.cost);
  result.cost.reads += particles.count;
  result.cost.bytes += particles.count * at(particles.dims) * sizeof(double);
  const SearchStart start{buckets, maps, scale, points, {}};
  auto found = TreeSearch(comm, particles, options, start, result.cost).find(go_on);
  if (!found) return std::nullopt;
  const std::span<std::int32_t> part = result.part.span();
  for (std::int32_t& own_part : part) own_part = found->part_of_bucket[at(own_part)];
  constexpr std::size_t kAhead = 16;  // the processor can't tell which come next
  for (const PointsOfPart& some : found->points) {
    std::int32_t* const first = part.data() + some.base;
    for (std::size_t k = 0; k < some.points.size(); ++k) {
      if (k + kAhead < some.points.size()) __builtin_prefetch(first + some.points[k + kAhead].index, 1);
      first[some.points[k].index] = some.part;
    }
    result.cost.bytes += some.points.size() * (sizeof(QuantisedPoint) + sizeof(std::int32_t));
  }
  result.cost.bytes += 3 * part.size_bytes();
  result.tree = std::move(found->tree);
  result.counts = std::move(found->counts);
  return result;
}

}  // namespace rcb::partition
