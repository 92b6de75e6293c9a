#include "common/partition/repartition.hpp"

#include <algorithm>
#include <numeric>
#include <optional>
#include <utility>

#include "common/base/index.hpp"
#include "common/partition/partition.hpp"
#include "common/partition/search/tree_search.hpp"

namespace rcb::partition {
namespace {

class Repartitioning {
 public:
  Repartitioning(comm::Comm& comm, const particles::ParticleView& particles, const RepartitionOptions& options,
                 const CurrentPartition& current)
      : comm_(comm), particles_(particles), options_(options), current_(current) {
    if (current.loads.weighted) scale_.emplace(current.loads.scale_exponent);
    counts_ = current.loads.counts;
    n_ = std::accumulate(counts_.begin(), counts_.end(), std::uint64_t{0});
    result_.tree = current.tree;
  }

  Repartition run() {
    const PartitionOptions& options = options_.partition;
    const bool near_cuts = options_.incremental && options.cut_tolerance == 0;
    if (options.parts == 1) {
      result_.incremental = true;
    } else if (!near_cuts || !search_near_cuts()) {
      result_.wasted = near_cuts;
      search_among_all();
    }
    result_.loads = scale_ ? moved_loads(comm_, particles_, current_.loads, current_.part, result_.delta.slot.span(),
                                         result_.delta.part.span(), options.part_sizes)
                           : summarise_counts(std::move(counts_), options.part_sizes);
    return std::move(result_);
  }

 private:
  std::uint64_t most_listed() const { return n_ / options_.partition.tuning.boundary_divisor; }
  // Searches the particles near the expected new cuts. False if they are too many. Collective.
  bool search_near_cuts();
  void search_among_all();

  comm::Comm& comm_;
  const particles::ParticleView& particles_;
  const RepartitionOptions& options_;
  const CurrentPartition& current_;
  std::optional<ExactScale> scale_;
  std::uint64_t n_ = 0;
  std::vector<std::uint64_t> counts_;
  Repartition result_;
};

bool Repartitioning::search_near_cuts() {
  const PartitionOptions& options = options_.partition;
  const GuideFromCuts guide = guide_from_cuts(comm_, particles_, current_, n_, options, result_.cost);
  AxisMaps maps = guide.guide.maps(particles_.dims);
  std::vector<Bucket> buckets = empty_buckets(options.parts, true, true);
  PointStore points(buckets.size(), points_together(particles_.count, buckets.size(), options.tuning));
  PutHeld put(particles_, current_, guide, maps, scale_, options.tuning, points);
  // The own count alone won't do: a rank may hold nothing but particles that have just left other ranks' parts.
  const std::uint64_t mean = n_ / static_cast<std::uint64_t>(comm_.size());
  const std::uint64_t most = std::max<std::uint64_t>(particles_.count, mean) / options.tuning.boundary_divisor;
  const OwnShare own = put.run(most);
  const std::vector<Load> leaving = sum_loads(comm_, own, scale_.has_value(), buckets, result_.cost);
  if (leaving.back().count > 0 || result_.cost.searched > most_listed()) return false;
  for (std::size_t p = 0; p < at(options.parts); ++p)
    buckets[Splitters::kBuckets + p].load = Load{current_.loads.counts[p], current_.loads.loads[p]} - leaving[p];
  reduce_boxes(comm_, own, buckets, result_.cost);
  note_boxes(buckets, maps, particles_.dims);
  reduce_lossless(comm_, own.lossless, maps, particles_.dims, result_.cost);
  const auto make = [&](std::span<const std::int32_t> wholes) {
    if (options_.before_search_of_all) options_.before_search_of_all();
    return put.make(wholes);
  };
  const SearchStart start{buckets, maps, scale_, points, make, most_listed()};
  std::optional<TreeFound> tree = TreeSearch(comm_, particles_, options, start, result_.cost).find({});
  if (!tree) return false;
  TreeFound& found = *tree;
  for (std::size_t b = 0; b < Splitters::kBuckets; ++b)
    for (const Segment& segment : points.take(b))
      found.points.push_back({segment.all(), segment.base, found.part_of_bucket[b]});
  result_.delta = put.changes(found.part_of_bucket, found.points);
  result_.cost.searched += found.opened;
  result_.tree = std::move(found.tree);
  if (!scale_) counts_ = std::move(found.counts);
  result_.incremental = found.opened == 0;
  result_.wasted = result_.cost.searched > most_listed();
  return true;
}

void Repartitioning::search_among_all() {
  result_.cost.searched = 0;
  if (options_.before_search_of_all) options_.before_search_of_all();
  PartitionResult found = partition(comm_, particles_, options_.partition).value();
  result_.cost += found.cost;
  // Without branches: half of them may have changed, in no order. Counted first, since growing lists would take twice
  // their memory.
  const std::span<const std::int32_t> before = current_.part;
  std::size_t changed = 0;
  for (std::size_t i = 0; i < before.size(); ++i) changed += found.part[i] == before[i] ? 0U : 1U;
  PartDelta& delta = result_.delta;
  delta.resize(changed + 1);  // what hasn't changed is written behind the last, too
  for (std::size_t i = 0, told = 0; i < before.size(); ++i) {
    delta.slot[told] = i;
    delta.part[told] = found.part[i];
    told += found.part[i] == before[i] ? 0U : 1U;
  }
  delta.resize(changed);
  result_.tree = std::move(found.tree);
  if (!scale_) counts_ = std::move(found.counts);
}

}  // namespace

Repartition repartition(comm::Comm& comm, const particles::ParticleView& particles, const RepartitionOptions& options,
                        const CurrentPartition& current) {
  return Repartitioning(comm, particles, options, current).run();
}

}  // namespace rcb::partition
