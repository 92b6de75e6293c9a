#include "common/partition/repartition.hpp"

#include <algorithm>
#include <bit>
#include <numeric>
#include <tuple>

#include "common/partition/build_tree.hpp"
#include "common/partition/gather_words.hpp"
#include "common/partition/settle.hpp"

namespace rcb::partition {
namespace {

std::size_t at(int index) { return static_cast<std::size_t>(index); }

class Repartitioning {
 public:
  Repartitioning(Comm& comm, const particles::ParticleView& particles, const RepartitionOptions& options,
                 const Standing& standing)
      : comm_(comm),
        particles_(particles),
        options_(options.partition),
        standing_(standing),
        before_search_of_all_(options.before_search_of_all),
        roots_(options.roots),
        whole_(roots_.empty() || roots_[0].parts() == standing.tree.parts),
        rule_(options_, particles.dims) {
    if (whole_) roots_.assign(1, standing.tree.root());
    if (standing.loads.weighted) scale_.emplace(standing.loads.scale_exponent);
    n_ = std::accumulate(standing.loads.counts.begin(), standing.loads.counts.end(), std::uint64_t{0});
    result_.tree = standing.tree;
    counts_ = standing.loads.counts;
    if (!whole_) share_roots_alone();
  }

  Repartition run(bool warm) {
    if (options_.parts > 1) {
      const bool tried = warm && options_.cut_tolerance == 0;
      if (!tried || !search_few()) {
        failed_ = roots_;
        result_.in_vain = tried;
      }
      if (!failed_.empty()) search_all();
      sort_delta();
    }
    result_.warm = failed_.empty();
    result_.loads = scale_ ? moved_loads(comm_, particles_, standing_.loads, standing_.part, result_.delta.slot.span(),
                                         result_.delta.part.span(), options_.part_sizes)
                           : summarise_counts(std::move(counts_), options_.part_sizes);
    return std::move(result_);
  }

 private:
  // A part's quota is its share of its root's particles; other parts keep what they have.
  void share_roots_alone() {
    rule_.set_all(n_, {});
    std::vector<std::uint64_t> quotas = standing_.loads.counts;
    for (const NodeRange& root : roots_) {
      const auto begin = quotas.begin() + root.first;
      const std::uint64_t count = std::accumulate(begin, quotas.begin() + root.last, std::uint64_t{0});
      std::uint64_t before = 0;
      for (int p = root.first; p < root.last; ++p) {
        const std::uint64_t upto = floor_share(count, rule_.size(root.first, p + 1), rule_.size(root.first, root.last));
        quotas[at(p)] = upto - before;
        before = upto;
      }
    }
    std::vector<std::uint64_t> upto(quotas.size() + 1, 0);
    std::partial_sum(quotas.begin(), quotas.end(), upto.begin() + 1);
    rule_.set_quotas(std::move(upto));
  }

  // Particles of this rank, copied, root after root.
  struct Copied {
    particles::ParticleSet particles;
    Buffer<std::uint64_t> slot;
    Buffer<std::int32_t> part;      // in force
    std::vector<std::size_t> ends;  // [roots]
  };

  // slots and the parts that they are in for now. Those in no root are left out.
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
    copy_of(standing_.part.data(), out.slot, out.part);
    out.particles.dims = particles_.dims;
    out.particles.has_weights = particles_.weight != nullptr;
    for (std::size_t a = 0; a < at(particles_.dims); ++a)
      copy_of(particles_.position[a], out.slot, out.particles.position[a]);
    copy_of(particles_.id, out.slot, out.particles.id);
    if (out.particles.has_weights) copy_of(particles_.weight, out.slot, out.particles.weight);
    return out;
  }

  // Whether few particles sufficed to search anything; failed_ then has what they left open. Collective.
  bool search_few() {
    std::vector<double> loads(standing_.loads.loads.begin(), standing_.loads.loads.end());
    const auto inner = inner_regions(comm_, particles_, standing_.part, standing_.tree, n_, loads, roots_,
                                     standing_.own, options_.limits);
    // A rank may hold nothing but particles that have just left others.
    const std::uint64_t mean = n_ / static_cast<std::uint64_t>(comm_.size());
    OwnSettled own = settle(particles_, standing_.blocks, standing_.part, inner, standing_.own,
                            std::max<std::uint64_t>(particles_.count, mean) / options_.limits.few_share);
    result_.reductions += 2;
    Settled settled;
    if (!gather(own, settled)) return false;
    const std::size_t count = own.slot.size();
    if (!whole_) own.few = {};
    const Copied few = whole_ ? Copied{std::move(own.few), std::move(own.slot), std::move(own.part), {count}}
                              : copy(roots_, own.slot.span(), own.part.span());
    const Start start{
        roots_, few.ends, &standing_.tree, whole_ ? nullptr : &rule_, scale_, &settled, n_ / options_.limits.few_share};
    TreeBuilder builder(comm_, few.particles.view(), options_, start);
    PartitionResult found = builder.build();
    if (builder.abandoned()) return false;
    failed_ = builder.failed();
    std::ranges::sort(failed_, {}, &NodeRange::first);
    rule_ = builder.rule();
    take(std::move(found), few.slot.span(), few.part.span(), roots_);
    return true;
  }

  // All ranks' shares. False, on every rank, where the few are too many. Collective (one gather).
  bool gather(const OwnSettled& own, Settled& settled) {
    // Whether this rank has too many; how many of the own parts have settled particles; where these are; then, of parts
    // that some of the few are of, how many and their weight.
    std::vector<std::uint64_t> few(at(options_.parts), 0);  // none where they are too many
    std::vector<u128> weights(few.size(), 0);
    for (std::size_t k = 0; k < own.part.size() && !own.too_many; ++k) {
      ++few[at(own.part[k])];
      if (scale_) weights[at(own.part[k])] += (*scale_)(own.few.weight[k]);
    }
    std::vector<std::uint64_t> mine{own.too_many ? 1U : 0U, 0};
    for (std::size_t p = 0; p < own.boxes.size(); ++p) {
      if (own.boxes[p].empty(particles_.dims)) continue;
      ++mine[1];
      mine.push_back(at(standing_.own.first) + p);
      for (const double x : own.boxes[p].lo) mine.push_back(std::bit_cast<std::uint64_t>(x));
      for (const double x : own.boxes[p].hi) mine.push_back(std::bit_cast<std::uint64_t>(x));
    }
    for (std::size_t p = 0; p < few.size(); ++p)
      if (few[p] > 0)
        mine.insert(mine.end(),
                    {p, few[p], static_cast<std::uint64_t>(weights[p]), static_cast<std::uint64_t>(weights[p] >> 64U)});
    const GatheredWords all = gather_words(comm_, mine);

    // Who isn't one of the few has settled.
    std::vector<std::uint64_t> counts = standing_.loads.counts;
    std::vector<u128> stay = scale_ ? standing_.loads.loads : std::vector<u128>(counts.size(), 0);
    settled.boxes.assign(at(options_.parts), geometry::Box{});
    bool too_many = false;
    const std::uint64_t* word = all.words.data();
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
        settled.boxes[word[0]].extend(box);
      }
      for (; word < end; word += 4) {
        counts[word[0]] -= word[1];
        stay[word[0]] -= word[2] | (u128{word[3]} << 64U);
        result_.looked_at += word[1];
      }
    }
    if (too_many || result_.looked_at > n_ / options_.limits.few_share) return false;
    settled.counts_upto.assign(1, 0);
    for (const std::uint64_t count : counts) settled.counts_upto.push_back(settled.counts_upto.back() + count);
    if (scale_) settled.weights_upto.assign(1, 0);
    for (std::size_t p = 0; p < stay.size() && scale_; ++p)
      settled.weights_upto.push_back(settled.weights_upto.back() + stay[p]);
    return true;
  }

  // failed_ among all their particles. Collective.
  void search_all() {
    if (before_search_of_all_) before_search_of_all_();
    if (failed_[0].parts() == options_.parts) {
      result_.looked_at = n_;
      result_.delta = {};
      take(TreeBuilder(comm_, particles_, options_, particles_.dims).build(), {}, standing_.part, roots_);
      return;
    }
    // Where the few went for now; all others are where they were.
    std::vector<std::uint8_t> open(at(options_.parts), 0);
    for (const NodeRange& root : failed_) std::fill(open.begin() + root.first, open.begin() + root.last, 1);
    std::vector<std::uint64_t> slots;
    std::vector<std::int32_t> parts;
    PartDelta kept;
    std::size_t next = 0;
    sort_delta();
    for (std::size_t i = 0; i < particles_.count; ++i) {
      std::int32_t part = standing_.part[i];
      if (next < result_.delta.slot.size() && result_.delta.slot[next] == i) part = result_.delta.part[next++];
      if (open[at(part)] != 0) {
        slots.push_back(i);
        parts.push_back(part);
      } else if (part != standing_.part[i]) {
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

  // What a search found among particles that are of these parts in force. slots: theirs; empty: all in order.
  void take(PartitionResult found, std::span<const std::uint64_t> slots, std::span<const std::int32_t> part,
            std::span<const NodeRange> roots) {
    // Counted first: lists that grow would take twice their memory.
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

  Comm& comm_;
  const particles::ParticleView& particles_;
  const PartitionOptions& options_;
  const Standing& standing_;
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

Repartition repartition(Comm& comm, const particles::ParticleView& particles, const RepartitionOptions& options,
                        const Standing& standing) {
  return Repartitioning(comm, particles, options, standing).run(options.warm);
}

}  // namespace rcb::partition
