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
        visit(root, own_, {});
      }
      leaves += leaves_ - before;
    }
    // A pass over all particles that cuts few of them would cost more than it saves.
    return levels_ > 0 && levels_ >= options_.limits.guess.levels_min * (part.empty() ? 1.0 : 0.1);
  }
  bool axis_open() const { return axis_open_; }

 private:
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
    std::uint32_t k;
  };
  struct Bracket {
    KeyBracket keys;
    Key cut;             // the expected one
    std::size_t before;  // sampled particles before it
    double variance;
    double share;  // of the sampled particles in the bracket
    bool bounded;  // else there is no bracket
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
          own, [lo = node.inner.lo[a], hi = node.inner.hi[a], x](std::uint32_t k) { return x[k] > lo && x[k] < hi; });
      own = own.first(own.size() - outside.size());
    }
    if (!own.empty()) out_.seen[p].extend(box_of(own));
  }

  void visit(const Node& node, std::span<std::uint32_t> own, std::span<std::uint32_t> beyond) {
    if (node.range.leaf() || node.level == kGuessLevels || node.leaves == 1 || own.empty()) return end(node, own);
    const std::optional<AxisOrder> axes = axes_of(node, own, beyond);
    if (!axes) {
      axis_open_ = true;
      return end(node, own);
    }
    const auto a = at((*axes)[0]);
    const Bracket bracket = bracket_of(node, own, *axes);
    if (node.spent + bracket.share > options_.limits.guess.boundary_max || !bracket.bounded) return end(node, own);
    out_.brackets[at(node.range.node)] = bracket.keys;
    levels_ += static_cast<double>(own.size()) / static_cast<double>(sample_.count());
    Cut& cut = out_.tree.cuts[at(node.range.node)];
    cut.right_empty = false;
    cut.axes = *axes;
    cut.key = bracket.cut;
    Node left = node;
    Node right = node;
    left.range = node.range.left();
    right.range = node.range.right();
    left.level = right.level = node.level + 1;
    left.leaves = (node.leaves + 1) / 2;
    right.leaves = node.leaves / 2;
    left.known = right.known = nullptr;
    left.spent = right.spent = node.spent + bracket.share;
    left.inner.hi[a] = std::min(node.inner.hi[a], bracket.keys.least.at[0]);
    right.inner.lo[a] = std::max(node.inner.lo[a], bracket.keys.most.at[0]);
    left.variance_hi[a] = right.variance_lo[a] = bracket.variance;
    left.cuts = right.cuts = node.cuts;
    left.cuts.hi[a] = right.cuts.lo[a] = bracket.cut.at[0];
    const auto divided =
        std::ranges::partition(beyond, [&](std::uint32_t k) { return outermost_->x(a, k) < bracket.cut.at[0]; });
    const auto beyond_left = static_cast<std::size_t>(divided.begin() - beyond.begin());
    visit(left, own.first(bracket.before), beyond.first(beyond_left));
    visit(right, own.subspan(bracket.before), beyond.subspan(beyond_left));
  }

  // The likeliest axis order. Of the root, only if the particles outside of the sample can't change its cut's axis: a
  // wrong one costs the search of a node, and of this one it would cost everything.
  std::optional<AxisOrder> axes_of(const Node& node, std::span<const std::uint32_t> own,
                                   std::span<const std::uint32_t> beyond) const {
    Box box = node.known != nullptr ? *node.known : box_of(own);
    for (const std::uint32_t k : beyond) box.extend(outermost_->particles.view().point(k), dims());
    Point extents{};
    for (std::size_t a = 0; a < at(dims()); ++a) {
      if (std::isfinite(node.cuts.lo[a])) box.lo[a] = node.cuts.lo[a];
      if (std::isfinite(node.cuts.hi[a])) box.hi[a] = node.cuts.hi[a];
      extents[a] = geometry::extent(box.lo[a], box.hi[a]);
    }
    const AxisOrder axes = geometry::order_by_extent(extents, dims());
    if (band_axis_) return geometry::with_first(axes, *band_axis_, dims());
    if (node.level > 0 || node.known != nullptr || outermost_ != nullptr || dims() == 1) return axes;
    const double reach = 1 + 2 * options_.limits.guess.overhang_max;
    if (extents[at(axes[1])] * reach > extents[at(axes[0])]) return std::nullopt;
    return axes;
  }

  // The bracket of a node's cut; divides the node's sampled particles at the expected one.
  Bracket bracket_of(const Node& node, std::span<std::uint32_t> own, const AxisOrder& axes) {
    const auto axis = at(axes[0]);
    const double all = size_prefix_[at(node.range.last)] - size_prefix_[at(node.range.first)];
    const double share = (size_prefix_[at(node.range.middle())] - size_prefix_[at(node.range.first)]) / all;
    const double* const x = sample_.particles.position[axis].data();
    double load = 0;
    double squares = 0;
    near_.clear();
    for (const std::uint32_t k : own) {
      near_.push_back({x[k], weight(k), k});
      load += weight(k);
      squares += weight(k) * weight(k);
    }
    Bracket found{};
    found.variance = (1 - share) * (1 - share) * node.variance_lo[axis] + share * share * node.variance_hi[axis] +
                     share * (1 - share) * squares;
    const double margin = options_.limits.bracket_sigmas * std::sqrt(found.variance) +
                          options_.limits.bracket_margin * load / static_cast<double>(own.size());
    const double wanted = load * share;
    // Word by word, until few are near, or these differ.
    double before = 0;
    for (std::size_t word = 0; narrow(before, wanted - margin, wanted + margin) && word < at(dims()); ++word)
      for (Valued& one : near_) {
        const Key own_key = key(one.k, axes);
        one.x = word + 1 < at(dims()) ? own_key.at[word + 1] : static_cast<double>(own_key.id);
      }
    std::ranges::sort(near_, [&](const Valued& a, const Valued& b) { return key(a.k, axes) < key(b.k, axes); });
    // The places in near_ of the bracket's ends and of the expected cut; those of its end if there is none.
    std::size_t least = near_.size();
    std::size_t cut = near_.size();
    std::size_t most = near_.size();
    for (std::size_t i = 0; i < near_.size() && most == near_.size(); ++i) {
      if (before <= wanted - margin) least = i;
      if (before <= wanted) cut = i;
      before += near_[i].weight;
      if (before >= wanted + margin) most = i;
    }
    if (least == near_.size() || most == near_.size()) return found;
    found.keys = {axes, key(near_[least].k, axes), key(near_[most].k, axes)};
    found.cut = key(near_[cut].k, axes);
    found.bounded = true;
    std::size_t on = 0;
    std::size_t within = 0;
    for (const std::uint32_t k : own) {
      on += x[k] == found.cut.at[0] ? 1U : 0U;
      within += x[k] >= found.keys.least.at[0] && x[k] <= found.keys.most.at[0] ? 1U : 0U;
    }
    const auto size = static_cast<double>(own.size());
    found.keys.whole = static_cast<double>(on) > 1 + options_.limits.guess.tied_max * size;
    found.share = static_cast<double>(found.keys.whole ? most - least + 1 : within) / size;
    if (!found.keys.whole) found.cut = key_between(found.cut.at[0], dims());
    const auto right = std::ranges::partition(own, [&](std::uint32_t k) {
      return x[k] < found.cut.at[0] || (found.keys.whole && x[k] == found.cut.at[0] && key(k, axes) < found.cut);
    });
    found.before = own.size() - right.size();
    return found;
  }

  // Leaves those in near_ between which the loads from `least` to `most` lie, and a few more: sorting all would take
  // longer. Adds the load before them. True if they are many and all have one x.
  bool narrow(double& before, double least, double most) {
    for (std::size_t size = 0; near_.size() > at(kBins) && size != near_.size();) {
      size = near_.size();
      const auto [lo, hi] = std::ranges::minmax(near_, {}, &Valued::x);
      const double start = lo.x * 0.5;
      if (lo.x == hi.x) return true;
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
    return false;
  }

  Key key(std::uint32_t k, const AxisOrder& axes) const {
    return key_of(sample_.particles.view().point(k), sample_.particles.id[k], axes, dims());
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
  guess.brackets.resize(guess.tree.cuts.size());
  guess.inner.assign(at(options.parts), Box::unbounded());
  guess.seen.resize(at(options.parts));
  SampleWalk walk(sample, outermost, options, guess);
  const bool found = walk.run(below);
  axis_open = walk.axis_open();
  if (!found) return std::nullopt;
  return guess;
}

}  // namespace rcb::partition
