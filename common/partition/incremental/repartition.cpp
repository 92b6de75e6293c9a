#include "common/partition/incremental/repartition.hpp"

#include <algorithm>
#include <bit>
#include <numeric>
#include <tuple>

#include "common/base/index.hpp"
#include "common/comm/gather.hpp"
#include "common/partition/incremental/classify_interior.hpp"
#include "common/partition/search/build_tree.hpp"

namespace rcb::partition {
namespace {

class Repartitioning {
 public:
  Repartitioning(comm::Comm& comm, const particles::ParticleView& particles, const RepartitionOptions& options,
                 const CurrentPartition& current)
      : comm_(comm),
        particles_(particles),
        options_(options.partition),
        current_(current),
        before_search_of_all_(options.before_search_of_all),
        roots_(options.roots),
        whole_(roots_.empty() || roots_[0].parts() == current.tree.parts),
        rule_(options_, particles.dims) {
    if (whole_) roots_.assign(1, current.tree.root());
    if (current.loads.weighted) scale_.emplace(current.loads.scale_exponent);
    n_ = std::accumulate(current.loads.counts.begin(), current.loads.counts.end(), std::uint64_t{0});
    result_.tree = current.tree;
    counts_ = current.loads.counts;
    if (!whole_) share_roots_alone();
  }

  Repartition run(bool incremental) {
    if (options_.parts > 1) {
      const bool tried = incremental && options_.cut_tolerance == 0;
      if (!tried || !search_boundary()) {
        failed_ = roots_;
        result_.wasted = tried;
      }
      if (!failed_.empty()) search_all();
      sort_delta();
    }
    result_.incremental = failed_.empty();
    result_.loads = scale_ ? moved_loads(comm_, particles_, current_.loads, current_.part, result_.delta.slot.span(),
                                         result_.delta.part.span(), options_.part_sizes)
                           : summarise_counts(std::move(counts_), options_.part_sizes);
    return std::move(result_);
  }

 private:
  // A part's quota is its share of its root's particles; parts outside the roots keep what they have.
  void share_roots_alone() {
    rule_.set_all(n_, {});
    std::vector<std::uint64_t> quotas = current_.loads.counts;
    for (const NodeRange& root : roots_) {
      const auto begin = quotas.begin() + root.first;
      const std::uint64_t count = std::accumulate(begin, quotas.begin() + root.last, std::uint64_t{0});
      std::uint64_t before = 0;
      for (int p = root.first; p < root.last; ++p) {
        const std::uint64_t prefix =
            floor_share(count, rule_.size(root.first, p + 1), rule_.size(root.first, root.last));
        quotas[at(p)] = prefix - before;
        before = prefix;
      }
    }
    std::vector<std::uint64_t> prefix(quotas.size() + 1, 0);
    std::partial_sum(quotas.begin(), quotas.end(), prefix.begin() + 1);
    rule_.set_quotas(std::move(prefix));
  }

  // Particles of this rank, copied and sorted by root.
  struct Copied {
    particles::ParticleSet particles;
    Buffer<std::uint64_t> slot;
    Buffer<std::int32_t> part;      // current parts
    std::vector<std::size_t> ends;  // [roots]
  };

  // parts[k]: the part of the particle in slots[k], as found so far. Particles of parts in no root are left out.
  Copied copy(std::span<const NodeRange> roots, std::span<const std::uint64_t> slots,
              std::span<const std::int32_t> parts) const {
    constexpr std::size_t kNone = ~std::size_t{0};
    std::vector<std::size_t> root_of(at(options_.parts), kNone);
    for (std::size_t r = 0; r < roots.size(); ++r)
      for (int p = roots[r].first; p < roots[r].last; ++p) root_of[at(p)] = r;
    Copied out;
    out.ends.assign(roots.size(), 0);
    for (const std::int32_t part : parts)
      if (root_of[at(part)] != kNone) ++out.ends[root_of[at(part)]];
    std::partial_sum(out.ends.begin(), out.ends.end(), out.ends.begin());
    const std::size_t count = roots.empty() ? 0 : out.ends.back();
    std::vector<std::size_t> next(roots.size(), 0);
    for (std::size_t r = 1; r < roots.size(); ++r) next[r] = out.ends[r - 1];
    out.slot.resize(count);
    for (std::size_t k = 0; k < slots.size(); ++k)
      if (const std::size_t root = root_of[at(parts[k])]; root != kNone) out.slot[next[root]++] = slots[k];
    copy_of(current_.part.data(), out.slot, out.part);
    out.particles.dims = particles_.dims;
    out.particles.has_weights = particles_.weight != nullptr;
    for (std::size_t a = 0; a < at(particles_.dims); ++a)
      copy_of(particles_.position[a], out.slot, out.particles.position[a]);
    copy_of(particles_.id, out.slot, out.particles.id);
    if (out.particles.has_weights) copy_of(particles_.weight, out.slot, out.particles.weight);
    return out;
  }

  // The incremental search. False if it was abandoned; else failed_ has the nodes that it could not cut. Collective.
  bool search_boundary() {
    std::vector<double> loads(current_.loads.loads.begin(), current_.loads.loads.end());
    const auto inner = inner_regions(comm_, particles_, current_.part, current_.tree, n_, loads, roots_, current_.own,
                                     options_.limits);
    // The own count alone won't do: a rank may hold nothing but particles that have just left other ranks' parts.
    const std::uint64_t mean = n_ / static_cast<std::uint64_t>(comm_.size());
    OwnInterior own =
        classify_interior(particles_, current_.blocks, current_.part, inner, current_.own,
                          std::max<std::uint64_t>(particles_.count, mean) / options_.limits.boundary_divisor);
    result_.reductions += 2;
    Interior interior;
    if (!gather(own, interior)) return false;
    const std::size_t count = own.slot.size();
    if (!whole_) own.boundary = {};
    const Copied boundary = whole_ ? Copied{std::move(own.boundary), std::move(own.slot), std::move(own.part), {count}}
                                   : copy(roots_, own.slot.span(), own.part.span());
    const Start start{roots_,
                      boundary.ends,
                      &current_.tree,
                      whole_ ? nullptr : &rule_,
                      scale_,
                      &interior,
                      n_ / options_.limits.boundary_divisor};
    TreeBuilder builder(comm_, boundary.particles.view(), options_, start);
    PartitionResult found = builder.build();
    if (builder.abandoned()) return false;
    failed_ = builder.failed();
    std::ranges::sort(failed_, {}, &NodeRange::first);
    rule_ = builder.rule();
    take(std::move(found), boundary.slot.span(), boundary.part.span(), roots_);
    return true;
  }

  // Sums up the interior particles of all ranks. False, on every rank, if boundary particles are too many. Collective
  // (one gather).
  bool gather(const OwnInterior& own, Interior& interior) {
    // The message: whether this rank has too many boundary particles; how many own parts have interior ones; each such
    // part and its box; then every part with boundary particles, their number and weight.
    std::vector<std::uint64_t> boundary(at(options_.parts), 0);  // zeros if there are too many
    std::vector<u128> weights(boundary.size(), 0);
    for (std::size_t k = 0; k < own.part.size() && !own.too_many; ++k) {
      ++boundary[at(own.part[k])];
      if (scale_) weights[at(own.part[k])] += (*scale_)(own.boundary.weight[k]);
    }
    std::vector<std::uint64_t> mine{own.too_many ? 1U : 0U, 0};
    for (std::size_t p = 0; p < own.boxes.size(); ++p) {
      if (own.boxes[p].empty(particles_.dims)) continue;
      ++mine[1];
      mine.push_back(at(current_.own.first) + p);
      for (const double x : own.boxes[p].lo) mine.push_back(std::bit_cast<std::uint64_t>(x));
      for (const double x : own.boxes[p].hi) mine.push_back(std::bit_cast<std::uint64_t>(x));
    }
    for (std::size_t p = 0; p < boundary.size(); ++p)
      if (boundary[p] > 0)
        mine.insert(mine.end(), {p, boundary[p], static_cast<std::uint64_t>(weights[p]),
                                 static_cast<std::uint64_t>(weights[p] >> 64U)});
    const auto all = comm::all_gather_values<std::uint64_t>(comm_, mine);

    // All particles but those on the boundary are interior.
    std::vector<std::uint64_t> counts = current_.loads.counts;
    std::vector<u128> stay = scale_ ? current_.loads.loads : std::vector<u128>(counts.size(), 0);
    interior.boxes.assign(at(options_.parts), geometry::Box{});
    bool too_many = false;
    const std::uint64_t* word = all.values.data();
    for (const std::size_t count : all.counts) {
      const std::uint64_t* const end = word + count;
      too_many |= *word++ != 0;
      std::uint64_t boxes = *word++;
      for (; boxes > 0; --boxes, word += 1 + 2 * geometry::kDimsMax) {
        geometry::Box box;
        for (std::size_t a = 0; a < geometry::kDimsMax; ++a) {
          box.lo[a] = std::bit_cast<double>(word[1 + a]);
          box.hi[a] = std::bit_cast<double>(word[1 + geometry::kDimsMax + a]);
        }
        interior.boxes[word[0]].extend(box);
      }
      for (; word < end; word += 4) {
        counts[word[0]] -= word[1];
        stay[word[0]] -= word[2] | (u128{word[3]} << 64U);
        result_.looked_at += word[1];
      }
    }
    if (too_many || result_.looked_at > n_ / options_.limits.boundary_divisor) return false;
    interior.count_prefix.assign(1, 0);
    for (const std::uint64_t count : counts) interior.count_prefix.push_back(interior.count_prefix.back() + count);
    if (scale_) interior.weight_prefix.assign(1, 0);
    for (std::size_t p = 0; p < stay.size() && scale_; ++p)
      interior.weight_prefix.push_back(interior.weight_prefix.back() + stay[p]);
    return true;
  }

  // Searches the nodes in failed_ among all their particles. Collective.
  void search_all() {
    if (before_search_of_all_) before_search_of_all_();
    if (failed_[0].parts() == options_.parts) {
      result_.looked_at = n_;
      result_.delta = {};
      take(TreeBuilder(comm_, particles_, options_, particles_.dims).build(), {}, current_.part, roots_);
      return;
    }
    // By the parts found so far: boundary particles may have changed theirs, all others have their current ones.
    std::vector<std::uint8_t> open(at(options_.parts), 0);
    for (const NodeRange& root : failed_) std::fill(open.begin() + root.first, open.begin() + root.last, 1);
    std::vector<std::uint64_t> slots;
    std::vector<std::int32_t> parts;
    PartDelta kept;
    std::size_t next = 0;
    sort_delta();
    for (std::size_t i = 0; i < particles_.count; ++i) {
      std::int32_t part = current_.part[i];
      if (next < result_.delta.slot.size() && result_.delta.slot[next] == i) part = result_.delta.part[next++];
      if (open[at(part)] != 0) {
        slots.push_back(i);
        parts.push_back(part);
      } else if (part != current_.part[i]) {
        kept.slot.push_back(i);
        kept.part.push_back(part);
      }
    }
    result_.delta = std::move(kept);
    const Copied some = copy(failed_, slots, parts);
    const Start start{failed_, some.ends, &result_.tree, &rule_, scale_, nullptr, 0};
    take(TreeBuilder(comm_, some.particles.view(), options_, start).build(), some.slot.span(), some.part.span(),
         failed_);
    for (const NodeRange& root : failed_)
      result_.looked_at += std::accumulate(counts_.begin() + root.first, counts_.begin() + root.last, std::uint64_t{0});
  }

  // Takes what a search found. part: the current parts of the particles searched; slots: their slots; empty: all, in
  // order.
  void take(PartitionResult found, std::span<const std::uint64_t> slots, std::span<const std::int32_t> part,
            std::span<const NodeRange> roots) {
    // Counted first: growing lists would take twice their memory.
    std::size_t changed = result_.delta.slot.size();
    for (std::size_t k = 0; k < part.size(); ++k) changed += found.part[k] == part[k] ? 0U : 1U;
    result_.delta.slot.reserve(changed);
    result_.delta.part.reserve(changed);
    for (std::size_t k = 0; k < part.size(); ++k) {
      if (found.part[k] == part[k]) continue;
      result_.delta.slot.push_back(slots.empty() ? k : slots[k]);
      result_.delta.part.push_back(found.part[k]);
    }
    if (!scale_)
      for (const NodeRange& root : roots)
        std::copy(found.counts.begin() + root.first, found.counts.begin() + root.last, counts_.begin() + root.first);
    result_.tree = std::move(found.tree);
    result_.rounds += found.rounds;
    result_.reductions += found.reductions;
  }

  void sort_delta() {
    PartDelta& delta = result_.delta;
    if (std::is_sorted(delta.slot.begin(), delta.slot.end())) return;
    std::vector<std::pair<std::uint64_t, std::int32_t>> pairs;
    for (std::size_t k = 0; k < delta.slot.size(); ++k) pairs.emplace_back(delta.slot[k], delta.part[k]);
    std::sort(pairs.begin(), pairs.end());
    for (std::size_t k = 0; k < pairs.size(); ++k) std::tie(delta.slot[k], delta.part[k]) = pairs[k];
  }

  comm::Comm& comm_;
  const particles::ParticleView& particles_;
  const PartitionOptions& options_;
  const CurrentPartition& current_;
  const std::function<void()>& before_search_of_all_;
  std::vector<NodeRange> roots_;
  bool whole_;
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
