#include "common/partition/incremental/guess.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "common/base/index.hpp"
#include "common/partition/search/split_rule.hpp"

namespace rcb::partition {
namespace {

using geometry::Box;

constexpr double kInfinity = Box::kInfinity;
constexpr std::int32_t kBins = 1024;

// Descends from the root; each node gets the sampled particles that the guessed cuts above leave it.
class SampleWalk {
 public:
  SampleWalk(const Sample& sample, const Sample* outermost, const PartitionOptions& options, Guess& out)
      : sample_(sample),
        outermost_(outermost),
        options_(options),
        band_axis_(SplitRule(options, sample.particles.dims).band_axis()),
        out_(out),
        indices_(sample.count()) {
    size_prefix_.assign(1, 0.0);
    for (int p = 0; p < options.parts; ++p)
      size_prefix_.push_back(size_prefix_.back() + (options.part_sizes.empty() ? 1.0 : options.part_sizes[at(p)]));
    const auto& weight = sample.particles.weight;
    weighted_ = std::ranges::any_of(weight, [&](double w) { return w != weight[0]; });
    for (std::uint32_t k = 0; k < sample.count(); ++k) indices_[k] = k;
    for (std::uint32_t k = 0; outermost != nullptr && k < outermost->count(); ++k) beyond_.push_back(k);
  }

  // True if enough cuts were guessed.
  bool run(const GuessRoots& below) {
    int inside = 0;
    for (const NodeRange& root : below.roots) inside += root.parts();
    int leaves = out_.tree.parts - inside;  // parts in no root
    std::vector<std::int32_t> part;
    if (below.roots.size() > 1 || below.roots[0].parts() < out_.tree.parts) {
      part.resize(sample_.count());
      below.tree.classify(sample_.particles.view(), part);
    }
    for (std::size_t r = 0; r < below.roots.size(); ++r) {
      Node root;
      root.range = below.roots[r];
      root.inner = Box::unbounded();
      root.known = below.boxes.empty() ? nullptr : &below.boxes[r];
      // What the other roots leave, one leaf each at least.
      const int others = static_cast<int>(below.roots.size() - r) - 1;
      root.leaves = kGuessLeaves - leaves - others;
      const int before = leaves_;
      if (part.empty()) {
        visit(root, indices_, beyond_);
      } else {
        own_.clear();
        for (const std::uint32_t k : indices_)
          if (part[k] >= root.range.first && part[k] < root.range.last) own_.push_back(k);
        seen_in_ = region(below.tree, root.range);
        visit(root, own_, {});
      }
      leaves += leaves_ - before;
    }
    // A pass over all particles that cuts few of them would cost more than it saves.
    return levels_ > 0 && levels_ >= options_.limits.guess.levels_min * (part.empty() ? 1.0 : 0.1);
  }
  bool axis_open() const { return axis_open_; }

 private:
  // The box that the cuts leave for a node.
  static Box region(const CutTree& tree, const NodeRange& node) {
    Box box = Box::unbounded();
    for (NodeRange range = tree.root(); range.parts() > node.parts();) {
      const Cut& cut = tree.cuts[at(range.node)];
      const bool right = node.first >= range.middle();
      if (!cut.right_empty) (right ? box.lo : box.hi)[at(cut.axes[0])] = cut.key.at[0];
      range = right ? range.right() : range.left();
    }
    return box;
  }

  struct Node {
    NodeRange range;
    int level = 0;
    Box inner;
    // Variance of the load below a face that is a cut, in the square of the sample's unit; 0: the face isn't a cut.
    Point variance_lo{};
    Point variance_hi{};
    // Where the face is a cut: the expected one; else not finite.
    Box cuts = {{kInfinity, kInfinity, kInfinity}, {-kInfinity, -kInfinity, -kInfinity}};
    double spent = 0;            // share of the particles on the brackets above
    const Box* known = nullptr;  // of all its particles; null: not known
    int leaves = 1;              // how many it may have
  };
  struct Valued {
    double x;
    double weight;
  };
  struct Bracket {
    double lo;
    double at;
    double hi;
    std::size_t before;  // sampled particles before `at`
    double variance;
    double share;  // of the sampled particles in [lo, hi]
    bool tied;     // too many lie at `at`
  };

  int dims() const { return sample_.particles.dims; }

  Box box_of(std::span<const std::uint32_t> own) const {
    Box box;
    for (std::size_t a = 0; a < at(dims()); ++a) {
      const double* const x = sample_.particles.position[a].data();
      double lo = kInfinity;
      double hi = -kInfinity;
      for (const std::uint32_t k : own) {
        lo = x[k] < lo ? x[k] : lo;
        hi = x[k] > hi ? x[k] : hi;
      }
      box.lo[a] = lo;
      box.hi[a] = hi;
    }
    return box;
  }

  void end(const Node& node, std::span<std::uint32_t> own) {
    ++leaves_;
    if (!node.range.leaf()) out_.ends[at(node.range.node)] = 1;
    const auto p = at(node.range.first);
    out_.inner[p] = node.inner;
    for (std::size_t a = 0; a < at(dims()); ++a) {
      const double* const x = sample_.particles.position[a].data();
      const auto outside = std::ranges::partition(
          own, [lo = std::max(node.inner.lo[a], seen_in_.lo[a]), hi = std::min(node.inner.hi[a], seen_in_.hi[a]),
                x](std::uint32_t k) { return x[k] > lo && x[k] < hi; });
      own = own.first(own.size() - outside.size());
    }
    if (!own.empty()) out_.seen[p].extend(box_of(own));
  }

  void visit(const Node& node, std::span<std::uint32_t> own, std::span<std::uint32_t> beyond) {
    if (node.range.leaf() || node.level == kGuessLevels || node.leaves == 1 || own.empty()) return end(node, own);
    const std::optional<int> axis = axis_of(node, own, beyond);
    if (!axis) {
      axis_open_ = true;
      return end(node, own);
    }
    const auto a = at(*axis);
    const Bracket bracket = bracket_of(node, own, a);
    if (node.spent + bracket.share > options_.limits.guess.boundary_max || bracket.tied || !std::isfinite(bracket.lo) ||
        !std::isfinite(bracket.hi))
      return end(node, own);
    levels_ += static_cast<double>(own.size()) / static_cast<double>(sample_.count());
    Cut& cut = out_.tree.cuts[at(node.range.node)];
    cut.right_empty = false;
    cut.axes = geometry::with_first({0, 1, 2}, *axis, dims());
    cut.key = key_between(bracket.at, dims());
    Node left = node;
    Node right = node;
    left.range = node.range.left();
    right.range = node.range.right();
    left.level = right.level = node.level + 1;
    left.leaves = (node.leaves + 1) / 2;
    right.leaves = node.leaves / 2;
    left.known = right.known = nullptr;
    left.spent = right.spent = node.spent + bracket.share;
    left.inner.hi[a] = std::min(node.inner.hi[a], bracket.lo);
    right.inner.lo[a] = std::max(node.inner.lo[a], bracket.hi);
    left.variance_hi[a] = right.variance_lo[a] = bracket.variance;
    left.cuts = right.cuts = node.cuts;
    left.cuts.hi[a] = right.cuts.lo[a] = bracket.at;
    const auto divided =
        std::ranges::partition(beyond, [&](std::uint32_t k) { return outermost_->x(a, k) < bracket.at; });
    const auto beyond_left = static_cast<std::size_t>(divided.begin() - beyond.begin());
    visit(left, own.first(bracket.before), beyond.first(beyond_left));
    visit(right, own.subspan(bracket.before), beyond.subspan(beyond_left));
  }

  // The likeliest cut axis. Of the root, only if the particles outside of the sample can't change it: a wrong axis
  // costs the search of a node, and of this one it would cost everything.
  std::optional<int> axis_of(const Node& node, std::span<const std::uint32_t> own,
                             std::span<const std::uint32_t> beyond) const {
    if (band_axis_) return band_axis_;
    Box box = node.known != nullptr ? *node.known : box_of(own);
    for (const std::uint32_t k : beyond) box.extend(outermost_->particles.view().point(k), dims());
    Point extents{};
    for (std::size_t a = 0; a < at(dims()); ++a) {
      if (std::isfinite(node.cuts.lo[a])) box.lo[a] = node.cuts.lo[a];
      if (std::isfinite(node.cuts.hi[a])) box.hi[a] = node.cuts.hi[a];
      extents[a] = geometry::extent(box.lo[a], box.hi[a]);
    }
    const int axis = geometry::order_by_extent(extents, dims())[0];
    if (node.level > 0 || node.known != nullptr || outermost_ != nullptr) return axis;
    for (int b = 0; b < dims(); ++b)
      if (b != axis && extents[at(b)] * (1 + 2 * options_.limits.guess.overhang_max) > extents[at(axis)])
        return std::nullopt;
    return axis;
  }

  // The bracket of a node's cut; divides the node's sampled particles at the expected one.
  Bracket bracket_of(const Node& node, std::span<std::uint32_t> own, std::size_t axis) {
    const double all = size_prefix_[at(node.range.last)] - size_prefix_[at(node.range.first)];
    const double share = (size_prefix_[at(node.range.middle())] - size_prefix_[at(node.range.first)]) / all;
    const double* const x = sample_.particles.position[axis].data();
    double load = 0;
    double squares = 0;
    near_.clear();
    for (const std::uint32_t k : own) {
      near_.push_back({x[k], weight(k)});
      load += weight(k);
      squares += weight(k) * weight(k);
    }
    Bracket found{};
    found.variance = (1 - share) * (1 - share) * node.variance_lo[axis] + share * share * node.variance_hi[axis] +
                     share * (1 - share) * squares;
    const double margin = options_.limits.bracket_sigmas * std::sqrt(found.variance) +
                          options_.limits.bracket_margin * load / static_cast<double>(own.size());
    const double wanted = load * share;
    double before = narrow(wanted - margin, wanted + margin);
    std::ranges::sort(near_, {}, &Valued::x);
    found.lo = -kInfinity;
    found.at = found.hi = kInfinity;
    for (const Valued& one : near_) {
      if (before <= wanted - margin) found.lo = one.x;
      if (before <= wanted) found.at = one.x;
      before += one.weight;
      if (before < wanted + margin) continue;
      found.hi = one.x;
      break;
    }
    std::size_t within = 0;
    std::size_t on = 0;
    for (const Valued& one : near_) on += one.x == found.at ? 1U : 0U;
    found.tied = static_cast<double>(on) > 1 + options_.limits.guess.tied_max * static_cast<double>(own.size());
    for (const Valued& one : near_) within += one.x >= found.lo && one.x <= found.hi ? 1U : 0U;
    found.share = static_cast<double>(within) / static_cast<double>(own.size());
    const auto right = std::ranges::partition(own, [&](std::uint32_t k) { return x[k] < found.at; });
    found.before = own.size() - right.size();
    return found;
  }

  // Leaves those in near_ between which the loads from `least` to `most` lie, and a few more: sorting all would take
  // longer. Returns the load before them.
  double narrow(double least, double most) {
    double before = 0;
    for (std::size_t size = 0; near_.size() > at(kBins) && size != near_.size();) {
      size = near_.size();
      const auto [lo, hi] = std::ranges::minmax(near_, {}, &Valued::x);
      const double start = lo.x * 0.5;
      const double bins_a_unit = static_cast<double>(kBins) / (hi.x * 0.5 - start);
      if (!std::isfinite(bins_a_unit)) break;
      const auto bin_of = [&](const Valued& one) {
        return std::min(static_cast<std::int32_t>((one.x * 0.5 - start) * bins_a_unit), kBins - 1);
      };
      bins_.fill(0);
      for (const Valued& one : near_) bins_[at(bin_of(one))] += one.weight;
      std::int32_t first = 0;
      while (first + 1 < kBins && before + bins_[at(first)] <= least) before += bins_[at(first++)];
      std::int32_t last = first;
      for (double reached = before + bins_[at(last)]; last + 1 < kBins && reached < most;) reached += bins_[at(++last)];
      std::erase_if(near_, [&](const Valued& one) { return bin_of(one) < first || bin_of(one) > last; });
    }
    return before;
  }

  double weight(std::uint32_t k) const { return weighted_ ? sample_.particles.weight[k] : 1.0; }

  const Sample& sample_;
  const Sample* outermost_;
  const PartitionOptions& options_;
  std::optional<int> band_axis_;
  Guess& out_;
  std::vector<double> size_prefix_;
  bool weighted_ = false;
  bool axis_open_ = false;
  double levels_ = 0;  // guessed cuts above a particle, on average
  int leaves_ = 0;
  std::vector<std::uint32_t> own_;
  // A sampled particle on the plane of an exact cut may be another node's, since its id isn't in the sample.
  Box seen_in_ = Box::unbounded();
  std::vector<std::uint32_t> indices_;
  std::vector<std::uint32_t> beyond_;
  std::vector<Valued> near_;
  std::array<double, at(kBins)> bins_;
};

}  // namespace

std::optional<Guess> guess_cuts(const Sample& sample, const Sample* outermost, const PartitionOptions& options,
                                const GuessRoots& below, bool& axis_open) {
  Guess guess;
  guess.tree = below.tree;
  guess.ends.assign(guess.tree.cuts.size(), 0);
  guess.inner.assign(at(options.parts), Box::unbounded());
  guess.seen.resize(at(options.parts));
  SampleWalk walk(sample, outermost, options, guess);
  const bool found = walk.run(below);
  axis_open = walk.axis_open();
  if (!found) return std::nullopt;
  return guess;
}

}  // namespace rcb::partition
