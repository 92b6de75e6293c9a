#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>

#include "common/base/index.hpp"
#include "common/comm/gather.hpp"
#include "common/partition/rules/split_rule.hpp"
#include "common/partition/sample/guide.hpp"

namespace rcb::partition {
namespace {

// Tells how many of a node's sampled particles are expected below its new cut.
class NewCuts {
 public:
  NewCuts(const CurrentPartition& current, const PartitionOptions& options, std::span<const SampledParticle> sample)
      : tree_(current.tree), rule_(options, tree_.dims) {
    for (const u128 load : current.loads.loads) load_.push_back(load_.back() + static_cast<double>(load));
    sampled_.assign(at(tree_.parts) + 1, 0);
    for (const SampledParticle& own : sample) ++sampled_[at(own.part) + 1];
    std::partial_sum(sampled_.begin(), sampled_.end(), sampled_.begin());
    load_of_one_ = load_.back() / static_cast<double>(sample.size());
  }

  // nullopt: not known.
  std::optional<SampledCut> operator()(const NodeRange& range, Sample own) const {
    const Cut& cut = tree_.cuts[at(range.node)];
    if (cut.right_empty || own.empty() || !(load_of_one_ > 0)) return std::nullopt;
    // The load below the old cut is that of the left parts, plus what the node has gained there, minus what they have
    // lost, both estimated from the sample.
    std::size_t below = 0;
    std::size_t gained = 0;
    std::size_t stayed = 0;
    for (const SampledParticle& one : own) {  // without branches: which it is can't be predicted
      const bool is_below = cuts::key_of(one.x, 0, cut.axes, tree_.dims) < cut.key;
      const bool mine = (one.part >= range.first) & (one.part < range.last);
      below += is_below ? 1U : 0U;
      stayed += mine & (one.part < range.middle()) ? 1U : 0U;
      gained += !mine & is_below ? 1U : 0U;
    }
    const auto lost = static_cast<double>(sampled_[at(range.middle())] - sampled_[at(range.first)] - stayed);
    const double had = load_[at(range.middle())] - load_[at(range.first)];
    const double wanted = load_.back() * static_cast<double>(rule_.size(range.first, range.middle())) /
                          static_cast<double>(rule_.size(0, tree_.parts));
    const double moved = static_cast<double>(gained) - lost;
    const double excess = (had - wanted) / load_of_one_ + moved;
    const double uncertain = std::abs(excess) + static_cast<double>(gained) + lost;
    return SampledCut{cut.axes, static_cast<double>(below) - excess, std::sqrt(uncertain)};
  }

 private:
  const CutTree& tree_;
  SplitRule rule_;
  std::vector<double> load_{0.0};     // of the parts below
  std::vector<std::size_t> sampled_;  // of the parts below
  double load_of_one_ = 0;            // what a sampled particle stands for
};

// The boxes that all brackets together leave for the parts.
std::vector<geometry::Box> inner_regions(CutTree tree, std::span<const Bracket> brackets) {
  const auto regions_with_cuts_at = [&](double Bracket::*end) {
    for (std::size_t k = 0; k < tree.cuts.size(); ++k) {
      tree.cuts[k].right_empty = false;
      tree.cuts[k].key.at[0] = brackets[k].*end;
    }
    return tree.regions(0, tree.parts);
  };
  std::vector<geometry::Box> inner = regions_with_cuts_at(&Bracket::least);
  const std::vector<geometry::Box> beyond = regions_with_cuts_at(&Bracket::most);
  for (std::size_t p = 0; p < inner.size(); ++p) inner[p].lo = beyond[p].lo;
  return inner;
}

}  // namespace

GuideFromCuts guide_from_cuts(comm::Comm& comm, const particles::ParticleView& particles,
                              const CurrentPartition& current, std::uint64_t count, const PartitionOptions& options,
                              SearchCost& cost) {
  const CutTree& tree = current.tree;
  const RepartitionSampleTuning& tuning = options.tuning.repartition_sample;
  const std::uint64_t wanted =
      std::clamp(tuning.per_part * static_cast<std::uint64_t>(tree.parts), tuning.min, tuning.max);
  const std::vector<std::size_t> slots = sampled_slots(particles.count, std::max<std::uint64_t>(count / wanted, 1));
  Buffer<SampledParticle> sample = gather_sample(comm, particles, slots, current.part);
  GuideFromCuts found;
  // One message: the guide, then the brackets of all cuts.
  constexpr std::size_t kGuide = (sizeof(Guide) + sizeof(Bracket) - 1) / sizeof(Bracket);
  std::vector<Bracket> message;
  // With more ranks than cores, copies of the same work would take longer than the rest.
  if (comm.rank() == 0) {
    message.resize(kGuide + tree.cuts.size());
    found.guide = Guide::of_sample(sample.span(), box_of(sample.span(), tree.dims), tree.dims);
    const NewCuts new_cut(current, options, sample.span());
    cut_sample(
        sample.span(), tree.root(), 0, options.tuning,
        [&](const NodeRange& range, std::size_t, Sample own) { return new_cut(range, own); },
        [&](const NodeRange& range, std::size_t heap, std::int32_t axis, const Bracket& bracket) {
          message[kGuide + at(range.node)] = bracket;
          if (heap < Splitters::kNodes) found.guide.splitters.nodes[heap] = {bracket.least, bracket.most, axis};
        });
    std::memcpy(static_cast<void*>(message.data()), &found.guide, sizeof(Guide));
  }
  const Buffer<Bracket> told = comm::values_of_first<Bracket>(comm, message);
  cost.reductions += 2;
  std::memcpy(static_cast<void*>(&found.guide), told.data(), sizeof(Guide));
  found.inner = inner_regions(tree, told.span().subspan(kGuide));
  return found;
}

}  // namespace rcb::partition
