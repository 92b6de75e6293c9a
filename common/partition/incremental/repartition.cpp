#include "common/partition/incremental/repartition.hpp"

#include <algorithm>
#include <numeric>
#include <optional>
#include <utility>

#include "common/base/index.hpp"
#include "common/partition/incremental/boundary_list.hpp"
#include "common/partition/incremental/classify_interior.hpp"
#include "common/partition/search/build_tree.hpp"

namespace rcb::partition {
namespace {

// The roots' particles, copied as boundary particles are; nullopt if they are too many.
std::optional<OwnInterior> copy_of_roots(const particles::ParticleView& particles, const Start& start, int parts) {
  const std::size_t most = particles.count / 4;
  const std::vector<std::int32_t> root_of = roots_of_parts(start.roots, parts);
  OwnInterior all;
  BoundaryList list(particles, start.part.data(), 0, all);
  for (std::size_t begin = 0; begin < particles.count && list.size() <= most; begin += particles::kBlock) {
    std::uint64_t which = 0;
    for (std::size_t i = 0; i < std::min(particles::kBlock, particles.count - begin); ++i)
      which |= std::uint64_t{root_of[at(start.part[begin + i])] != Roots::kNone} << i;
    if (which != 0) list.append(begin, which);
  }
  list.finish(most);
  return all.too_many ? std::nullopt : std::optional(std::move(all));
}

// Cuts start.roots, not all of the tree, among all their particles, and writes start.part. On a rank where these are at
// most a quarter of the particles the search passes over copies of them; copies of more would take more memory than the
// search. Collective.
PartitionResult search_roots(comm::Comm& comm, const particles::ParticleView& particles,
                             const PartitionOptions& options, Start start) {
  auto own = copy_of_roots(particles, start, options.parts);
  if (!own) return TreeBuilder(comm, particles, options, std::move(start)).build().value();
  const std::span<std::int32_t> part = std::exchange(start.part, own->part.span());
  PartitionResult found = TreeBuilder(comm, own->view(particles), options, std::move(start)).build().value();
  for (std::size_t k = 0; k < own->part.size(); ++k) part[own->slot[k]] = own->part[k];
  return found;
}

class Repartitioning {
 public:
  Repartitioning(comm::Comm& comm, const particles::ParticleView& particles, const RepartitionOptions& options,
                 const CurrentPartition& current)
      : comm_(comm),
        particles_(particles),
        options_(options.partition),
        current_(current),
        before_search_of_all_(options.before_search_of_all),
        rule_(options_, particles.dims) {
    if (current.loads.weighted) scale_.emplace(current.loads.scale_exponent);
    n_ = std::accumulate(current.loads.counts.begin(), current.loads.counts.end(), std::uint64_t{0});
    result_.tree = current.tree;
    counts_ = current.loads.counts;
  }

  Repartition run(bool incremental) {
    if (options_.parts > 1) {
      failed_ = {current_.tree.root()};
      result_.wasted = incremental && options_.cut_tolerance == 0 && !search_boundary();
      if (!failed_.empty()) search_all();
    }
    result_.incremental = failed_.empty();
    result_.loads = scale_ ? moved_loads(comm_, particles_, current_.loads, current_.part, result_.delta.slot.span(),
                                         result_.delta.part.span(), options_.part_sizes)
                           : summarise_counts(std::move(counts_), options_.part_sizes);
    return std::move(result_);
  }

 private:
  // The incremental search. False if it was abandoned; else failed_ becomes the nodes that it could not cut.
  // Collective.
  bool search_boundary() {
    const InnerRegions inner = inner_regions(comm_, particles_, current_, n_, options_);
    // The own count alone won't do: a rank may hold nothing but particles that have just left other ranks' parts.
    const std::uint64_t mean = n_ / static_cast<std::uint64_t>(comm_.size());
    const OwnInterior own =
        classify_interior(particles_, current_.blocks, current_.part, inner.boxes, current_.own,
                          std::max<std::uint64_t>(particles_.count, mean) / options_.limits.boundary_divisor);
    result_.reductions += 3;
    const std::uint64_t most = n_ / options_.limits.boundary_divisor;
    const auto interior = sum_interior(comm_, own, current_.own, current_.loads, most, result_.looked_at);
    if (!interior) return false;
    Buffer<std::int32_t> part = own.part;
    TreeBuilder builder(comm_, own.view(particles_), options_,
                        {.part = part.span(),
                         .tree = &current_.tree,
                         .scale = scale_,
                         .interior = &*interior,
                         .splitters = &inner.splitters,
                         .failed_max = most});
    auto found = builder.build();
    if (!found) return false;
    rule_ = builder.rule();
    tell_changes(part.span(), own.part.span(), [&own](std::size_t k) { return own.slot[k]; });
    take(*std::move(found), failed_);
    failed_ = builder.uncut();
    return true;
  }

  // Searches the nodes in failed_ among all their particles. Collective.
  void search_all() {
    if (before_search_of_all_) before_search_of_all_();
    const bool whole = failed_[0].parts() == options_.parts;
    Buffer<std::int32_t> part(whole ? 0 : particles_.count);
    if (!whole) std::ranges::copy(current_.part, part.begin());
    for (std::size_t k = 0; k < result_.delta.slot.size() && !whole; ++k)
      part[result_.delta.slot[k]] = result_.delta.part[k];
    std::optional<LargeSetSample> large;
    if (whole && !scale_ && is_large(n_, comm_.size(), options_.limits.buckets))
      large = sample_large_set(comm_, particles_, options_, result_.reductions);
    PartitionResult found;
    if (!whole) {
      found =
          search_roots(comm_, particles_, options_,
                       {.roots = failed_, .part = part.span(), .tree = &result_.tree, .rule = &rule_, .scale = scale_});
    } else {
      Start start;
      if (large) start = {.sample = SortedSample(large->sample), .stride = large->stride};
      found = TreeBuilder(comm_, particles_, options_, std::move(start)).build().value();
      part = std::move(found.part);
    }
    tell_changes(part.span(), current_.part, [](std::size_t i) { return i; });
    result_.looked_at = (whole ? 0 : result_.looked_at) + found.searched;
    take(std::move(found), failed_);
  }

  // Sets result_.delta to the particles whose part isn't what it was. Without branches: half of them may have changed,
  // in no order. Counted first, since growing lists would take twice their memory.
  template <typename SlotOf>
  void tell_changes(std::span<const std::int32_t> now, std::span<const std::int32_t> before, const SlotOf& slot_of) {
    std::size_t changed = 0;
    for (std::size_t i = 0; i < now.size(); ++i) changed += now[i] == before[i] ? 0U : 1U;
    PartDelta& delta = result_.delta;
    delta.slot.resize(changed + 1);  // what hasn't changed is written behind the last, too
    delta.part.resize(changed + 1);
    std::uint64_t* const slot = delta.slot.data();
    std::int32_t* const part = delta.part.data();
    for (std::size_t i = 0, told = 0; i < now.size(); ++i) {
      slot[told] = slot_of(i);
      part[told] = now[i];
      told += now[i] == before[i] ? 0U : 1U;
    }
    delta.slot.resize(changed);
    delta.part.resize(changed);
  }

  // Takes the cuts below these roots, and the counts of their parts.
  void take(PartitionResult found, std::span<const NodeRange> roots) {
    if (!scale_)
      for (const NodeRange& root : roots)
        std::copy(found.counts.begin() + root.first, found.counts.begin() + root.last, counts_.begin() + root.first);
    result_.tree = std::move(found.tree);
    result_.rounds += found.rounds;
    result_.reductions += found.reductions;
  }

  comm::Comm& comm_;
  const particles::ParticleView& particles_;
  const PartitionOptions& options_;
  const CurrentPartition& current_;
  const std::function<void()>& before_search_of_all_;
  SplitRule rule_;
  std::optional<ExactScale> scale_;
  std::uint64_t n_ = 0;
  std::vector<NodeRange> failed_;
  std::vector<std::uint64_t> counts_;
  Repartition result_;
};

}  // namespace

Repartition repartition(comm::Comm& comm, const particles::ParticleView& particles, const RepartitionOptions& options,
                        const CurrentPartition& current) {
  return Repartitioning(comm, particles, options, current).run(options.incremental);
}

}  // namespace rcb::partition
