#include "common/partition/incremental/brackets.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>

#include "common/base/index.hpp"
#include "common/comm/gather.hpp"
#include "common/partition/search/divide.hpp"
#include "common/partition/search/sample.hpp"
#include "common/partition/search/split_rule.hpp"

namespace rcb::partition {
namespace {

// Sampled particles of all ranks together: so many per part, within these limits.
constexpr std::uint64_t kSampleOfPart = 128;
constexpr std::uint64_t kSampleMin = 4096;
constexpr std::uint64_t kSampleMax = 8192;
constexpr double kFewOfSide = 8;  // a place within this fraction of a side is sorted out by a heap

// Descends the tree and guesses the new cuts; each node gets the sampled particles that the guessed cuts above leave
// it.
class BracketGuess {
 public:
  BracketGuess(const CurrentPartition& current, const PartitionOptions& options, const Sample& sample,
               std::span<geometry::Box> boxes)
      : tree_(current.tree),
        rule_(options, tree_.dims),
        own_(current.own),
        limits_(options.limits),
        sample_(sample),
        boxes_(boxes) {
    prefix_.assign(1, 0.0);
    for (const u128 load : current.loads.loads) prefix_.push_back(prefix_.back() + static_cast<double>(load));
    sampled_prefix_.assign(at(tree_.parts) + 1, 0);
    for (std::uint32_t k = 0; k < sample.count(); ++k) ++sampled_prefix_[at(sample.part[k]) + 1];
    std::partial_sum(sampled_prefix_.begin(), sampled_prefix_.end(), sampled_prefix_.begin());
  }

  // Guesses those of the upper levels.
  Splitters upper_cuts() {
    Splitters upper;
    for (std::size_t a = 0; a < at(tree_.dims); ++a) upper.rounded.fit(a, sample_.position[a].span());
    visit_upper(tree_.root(), 0, all_sampled(), prefix_.back(), upper);
    return upper;
  }

  // Finds the inner regions of this rank's parts.
  void find_regions(const Splitters& upper) {
    upper_ = &upper;
    visit(tree_.root(), 0, geometry::Box::unbounded(), all_sampled(), prefix_.back());
  }

 private:
  std::span<std::uint32_t> all_sampled() {
    indices_.resize(sample_.count());
    std::iota(indices_.begin(), indices_.end(), 0U);
    return indices_;
  }

  double load(int first, int last) const { return prefix_[at(last)] - prefix_[at(first)]; }

  // number: of the node, among the splitters; own: its sampled particles; wanted: its load under the new cuts.
  void visit_upper(const NodeRange& range, std::size_t number, std::span<std::uint32_t> own, double wanted,
                   Splitters& upper) {
    if (range.leaf() || number >= Splitters::kNodes) return;
    const ExpectedCut cut = upper.expected[number] = guess_cut(range, own, wanted);
    const auto axis = at(cut.axis);
    upper.nodes[number] = {upper.rounded(axis, cut.least), upper.rounded(axis, cut.most), cut.axis};
    const std::size_t left = divide_at(cut.likeliest, axis, own);
    const double share = rule_.left_share(range);
    visit_upper(range.left(), 2 * number + 1, own.first(left), wanted * share, upper);
    visit_upper(range.right(), 2 * number + 2, own.subspan(left), wanted * (1 - share), upper);
  }

  void visit(const NodeRange& range, std::size_t number, const geometry::Box& inner, std::span<std::uint32_t> own,
             double wanted) {
    if (range.last <= own_.first || range.first >= own_.last) return;
    if (range.leaf()) {
      boxes_[at(range.first - own_.first)] = inner;
      return;
    }
    const ExpectedCut cut = number < Splitters::kNodes ? upper_->expected[number] : guess_cut(range, own, wanted);
    const auto axis = at(cut.axis);
    geometry::Box left = inner;
    geometry::Box right = inner;
    left.hi[axis] = std::min(left.hi[axis], cut.least);
    right.lo[axis] = std::max(right.lo[axis], cut.most);
    const std::size_t before = divide_at(cut.likeliest, axis, own);
    const double share = rule_.left_share(range);
    visit(range.left(), 2 * number + 1, left, own.first(before), wanted * share);
    visit(range.right(), 2 * number + 2, right, own.subspan(before), wanted * (1 - share));
  }

  std::size_t divide_at(double at, std::size_t axis, std::span<std::uint32_t> own) {
    return divide(own, others_, [&](std::uint32_t k) { return sample_.x(axis, k) < at; });
  }

  ExpectedCut guess_cut(const NodeRange& range, std::span<const std::uint32_t> own, double wanted) {
    const Cut& cut = tree_.cuts[at(range.node)];
    const auto axis = at(cut.axes[0]);
    if (cut.right_empty) return {.axis = cut.axes[0]};
    const double old = cut.key.at[0];
    left_.resize(own.size());
    right_.resize(own.size());
    std::size_t lefts = 0;
    // The load below the old cut is that of the left parts, plus what the node has gained there, minus what they have
    // lost, both estimated from the sample.
    std::size_t gained_left = 0;
    std::size_t stayed_left = 0;
    for (std::size_t i = 0; i < own.size(); ++i) {  // without branches: which side it is can't be predicted
      const double x = sample_.x(axis, own[i]);
      const bool left = x < old;
      left_[lefts] = x;
      right_[i - lefts] = x;
      lefts += left ? 1U : 0U;
      const std::int32_t part = sample_.part[own[i]];
      const bool mine = (part >= range.first) & (part < range.last);
      stayed_left += mine & (part < range.middle()) ? 1U : 0U;
      gained_left += !mine & left ? 1U : 0U;
    }
    left_.resize(lefts);
    right_.resize(own.size() - lefts);
    const auto gained = static_cast<double>(gained_left);
    const auto had = [&](int first, int last) {
      return static_cast<double>(sampled_prefix_[at(last)] - sampled_prefix_[at(first)]);
    };
    const double lost = had(range.first, range.middle()) - static_cast<double>(stayed_left);
    const double load_of_one = prefix_.back() / static_cast<double>(sample_.count());
    if (own.empty() || !(load_of_one > 0)) return {.axis = cut.axes[0]};
    const double excess =
        (load(range.first, range.middle()) - wanted * rule_.left_share(range)) / load_of_one + gained - lost;
    const double margin = limits_.bracket_sigmas * std::sqrt(std::abs(excess) + gained + lost) + limits_.bracket_margin;
    // Places as seen from the old cut: k > 0: the k-th nearest below it; else number -k above it, counted from 0.
    const std::array<double, 3> places{std::ceil(excess + margin), std::round(excess), std::floor(excess - margin)};
    std::array<double, 3> found{-geometry::Box::kInfinity, -geometry::Box::kInfinity, -geometry::Box::kInfinity};
    for (std::size_t k = 0; k < places.size(); ++k)
      if (places[k] > 0) found[k] = take_nearest(left_, places[k] - 1, -geometry::Box::kInfinity, std::greater<>());
    for (std::size_t k = places.size(); k-- > 0;)
      if (!(places[k] > 0)) found[k] = take_nearest(right_, -places[k], geometry::Box::kInfinity, std::less<>());
    return {cut.axes[0], found[0], found[2], found[1]};
  }

  // The coordinate in this place on a side, 0 the nearest, or `none`. Shortens the side to this place, so that a later
  // call with a nearer one sorts less.
  template <typename Nearer>
  static double take_nearest(std::vector<double>& side, double place, double none, const Nearer& nearer) {
    if (place >= static_cast<double>(side.size())) return none;
    const auto nth = side.begin() + static_cast<std::ptrdiff_t>(place);
    // Mostly few are wanted: then hardly any of the others is nearer than those, which is soon seen.
    if (place * kFewOfSide < static_cast<double>(side.size()))
      std::partial_sort(side.begin(), nth + 1, side.end(), nearer);
    else
      std::nth_element(side.begin(), nth, side.end(), nearer);
    side.erase(nth + 1, side.end());
    return side.back();
  }

  const CutTree& tree_;
  SplitRule rule_;
  OwnParts own_;
  const SearchLimits& limits_;
  const Sample& sample_;
  std::span<geometry::Box> boxes_;  // [own parts]
  const Splitters* upper_ = nullptr;
  std::vector<double> prefix_;
  std::vector<std::size_t> sampled_prefix_;
  std::vector<std::uint32_t> indices_;
  std::vector<std::uint32_t> others_;
  std::vector<double> left_;
  std::vector<double> right_;
};

}  // namespace

InnerRegions inner_regions(comm::Comm& comm, const particles::ParticleView& particles, const CurrentPartition& current,
                           std::uint64_t count, const PartitionOptions& options) {
  const int parts = current.tree.parts;
  const std::uint64_t wanted = std::clamp(kSampleOfPart * static_cast<std::uint64_t>(parts), kSampleMin, kSampleMax);
  const std::vector<std::size_t> slots = pick(particles.count, std::max<std::uint64_t>(count / wanted, 1));
  // With more ranks than cores, copies of the same work would take longer than the rest: so rank 0 alone guesses the
  // upper cuts, and tells the others.
  const bool upper_alone = at(parts) <= Splitters::kNodes + 1;
  const Sample sample = upper_alone ? gather_sample(comm, particles, slots, current.part)
                                    : share_sample(comm, particles, slots, current.part);
  InnerRegions found;
  found.boxes.assign(at(current.own.last - current.own.first), geometry::Box::unbounded());
  BracketGuess walk(current, options, sample, found.boxes);
  if (comm.rank() == 0) found.splitters = walk.upper_cuts();
  found.splitters = comm::values_of_first<Splitters>(comm, {&found.splitters, 1})[0];
  walk.find_regions(found.splitters);
  return found;
}

}  // namespace rcb::partition
