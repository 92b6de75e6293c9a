#include "common/partition/partition.hpp"

#include <algorithm>
#include <cmath>
#include <optional>

#include "common/base/index.hpp"
#include "common/comm/wide_sum.hpp"
#include "common/partition/balance/bounds.hpp"
#include "common/partition/buckets/pass.hpp"
#include "common/partition/sample/guide.hpp"
#include "common/partition/search/tree_search.hpp"

namespace rcb::partition {
namespace {

Status check(const PartitionOptions& options, int dims) {
  const auto bad = [](std::string message, std::string hint) {
    return Status(Code::invalid_argument, std::move(message), std::move(hint));
  };
  if (dims < 1 || dims > geometry::kDimsMax)
    return bad("dims is " + std::to_string(dims), "positions have 1, 2 or 3 dimensions");
  if (options.parts < 1) return bad("parts is " + std::to_string(options.parts), "give 1 or more");
  const auto& sizes = options.part_sizes;
  if (!sizes.empty() && sizes.size() != static_cast<std::size_t>(options.parts))
    return bad(std::to_string(sizes.size()) + " part sizes for " + std::to_string(options.parts) + " parts",
               "give one size for each part");
  for (std::size_t p = 0; p < sizes.size(); ++p)
    if (!std::isfinite(sizes[p]) || !(sizes[p] > 0))
      return bad("the size of part " + std::to_string(p) + " is not a finite number > 0", "sizes are relative shares");
  if (!std::isfinite(options.axis_hysteresis) || !(options.axis_hysteresis >= 1))
    return bad("axis_hysteresis is not a finite number >= 1", "1 follows the extents alone");
  if (!std::isfinite(options.cut_tolerance) || !(options.cut_tolerance >= 0))
    return bad("cut_tolerance is not a finite number >= 0", "0 gives exact cuts");
  if (band_axis(options.method).value_or(0) >= dims)
    return bad(std::string(method_name(options.method)) + " needs an axis that " + std::to_string(dims) +
                   "-dimensional positions lack",
               "choose rcb or bands-x");
  return {};
}

// The tree of equal boxes: every box is halved at lo/2 + hi/2 across its longest side.
void halve(CutTree& tree, const NodeRange& range, const Point& lo, const Point& hi) {
  if (range.leaf()) return;
  Cut& cut = tree.cuts[static_cast<std::size_t>(range.node)];
  cut.axes = geometry::order_by_extent(geometry::Box{lo, hi}.extents(tree.dims), tree.dims);
  const auto axis = static_cast<std::size_t>(cut.axes[0]);
  const double middle = lo[axis] * 0.5 + hi[axis] * 0.5 + 0.0;
  cut.key = key_between(middle, tree.dims);  // coordinates equal to the middle go right
  Point left_hi = hi;
  Point right_lo = lo;
  left_hi[axis] = right_lo[axis] = middle;
  halve(tree, range.left(), lo, left_hi);
  halve(tree, range.right(), right_lo, hi);
}

Status given_up() { return {Code::aborted, "the partition was given up"}; }

Result<PartitionResult> equal_boxes(comm::Comm& comm, const particles::ParticleView& particles,
                                    const PartitionOptions& options, const comm::GoOn& go_on) {
  PartitionResult result;
  result.tree = uncut_tree(options, particles.dims);
  const geometry::Box box = bounding_box(comm, particles);
  ++result.cost.reductions;
  if (box.empty(particles.dims)) {
    for (Cut& cut : result.tree.cuts) cut.right_empty = true;
  } else {
    halve(result.tree, result.tree.root(), box.lo, box.hi);
  }
  if (go_on && !go_on()) return given_up();
  result.part.resize(particles.count);
  result.tree.classify(particles, result.part.span());
  return result;
}

// The pass: makes the points of all particles, bucket by bucket; part[i] becomes the bucket of particle i. Without
// splitters all are in bucket 0, and neither this nor its box is told. Local.
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
    if (guide.split) {
      put(x, bucket);
      std::copy_n(bucket.begin(), std::min(kBlock, particles.count - first), part.data() + first);
    }
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

// A full search, among all particles. `options` are valid, and the method is one whose cuts are searched.
// Collective.
Result<PartitionResult> search_all(comm::Comm& comm, const particles::ParticleView& particles,
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
  if (go_on && !go_on()) return given_up();
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
  reduce_lossless(comm, own.lossless, maps, particles.dims, result.cost);
  result.cost.reads += particles.count;
  result.cost.bytes += particles.count * at(particles.dims) * sizeof(double);
  const SearchStart start{buckets, maps, scale, points, {}};
  auto found = TreeSearch(comm, particles, options, start, result.cost).find(go_on);
  if (!found) return given_up();
  const std::span<std::int32_t> part = result.part.span();
  if (split)
    for (std::int32_t& own_part : part) own_part = found->part_of_bucket[at(own_part)];
  else if (found->part_of_bucket[0] >= 0)  // all go one way
    std::ranges::fill(part, found->part_of_bucket[0]);
  constexpr std::size_t kAhead = 16;  // the processor can't tell which come next
  for (const PointsOfPart& some : found->points) {
    std::int32_t* const first = part.data() + some.base;
    for (std::size_t k = 0; k < some.points.size(); ++k) {
      if (k + kAhead < some.points.size()) __builtin_prefetch(first + some.points[k + kAhead].index, 1);
      first[some.points[k].index] = some.part;
    }
    result.cost.bytes += some.points.size() * (sizeof(QuantisedPoint) + sizeof(std::int32_t));
  }
  if (split) result.cost.bytes += 3 * part.size_bytes();
  result.tree = std::move(found->tree);
  result.counts = std::move(found->counts);
  return result;
}

// Where all particles lie in one place, ids alone divide them.
Result<PartitionResult> file_order(comm::Comm& comm, const particles::ParticleView& particles,
                                   const PartitionOptions& options, const comm::GoOn& go_on) {
  Buffer<double> place(particles.count);
  std::fill(place.begin(), place.end(), 0.0);
  particles::ParticleView in_one_place = particles;
  in_one_place.dims = 1;
  in_one_place.position = {place.data()};
  in_one_place.weight = nullptr;
  const PartitionOptions by_id{.parts = options.parts, .part_sizes = options.part_sizes, .tuning = options.tuning};
  Result<PartitionResult> result = search_all(comm, in_one_place, by_id, go_on);
  if (result) result->tree = CutTree{};
  return result;
}

}  // namespace

Result<PartitionResult> partition(comm::Comm& comm, const particles::ParticleView& particles,
                                  const PartitionOptions& options, const comm::GoOn& go_on) {
  if (Status status = check(options, particles.dims); !status.ok()) return status;
  if (options.method == Method::equal_boxes) return equal_boxes(comm, particles, options, go_on);
  if (options.method == Method::file_order) return file_order(comm, particles, options, go_on);
  return search_all(comm, particles, options, go_on);
}

}  // namespace rcb::partition
