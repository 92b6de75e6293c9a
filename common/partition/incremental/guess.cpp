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
        out_(out) {
    size_prefix_.assign(1, 0.0);
    for (int p = 0; p < options.parts; ++p)
      size_prefix_.push_back(size_prefix_.back() + (options.part_sizes.empty() ? 1.0 : options.part_sizes[at(p)]));
    const auto& weight = sample.particles.weight;
    weighted_ = std::ranges::any_of(weight, [&](double w) { return w != weight[0]; });
    for (auto* array : {&x_[0], &x_[1], &x_[2], &weight_, &moved_}) array->resize(sample.count());
    for (auto* array : {&index_, &left_, &right_}) array->resize(sample.count());
    bin_.resize(sample.count());
    for (std::uint32_t k = 0; outermost != nullptr && k < outermost->count(); ++k) beyond_.push_back(k);
  }

  // True if enough cuts were guessed.
  bool run(const GuessRoots& below) {
    before_ = below.before;
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
      // The leaves that are left; each root that follows needs at least one.
      const int others = static_cast<int>(below.roots.size() - r) - 1;
      root.leaves = kGuessLeaves - leaves - others;
      const int before = leaves_;
      const Range own = load(part, root.range);
      visit(root, own, part.empty() ? std::span(beyond_) : std::span<std::uint32_t>());
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
    double x;  // or the next component of its key
    double weight;
    std::uint32_t k;
  };
  struct Keyed {
    Key key;
    double weight;
  };
  // Of a node's sampled particles in x_, weight_ and index_.
  struct Range {
    std::size_t first = 0;
    std::size_t last = 0;
    std::size_t size() const { return last - first; }
  };
  struct Order {
    AxisOrder axes;
    bool first_open;   // not sure: whether the first axis is the longest
    bool others_open;  // not sure: in which order the others follow
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

  // Takes a root's sampled particles over. part: of all; empty: all are its own.
  Range load(std::span<const std::int32_t> part, const NodeRange& root) {
    Range own;
    for (std::uint32_t k = 0; k < sample_.count(); ++k) {
      index_[own.last] = k;
      own.last += part.empty() || (part[k] >= root.first && part[k] < root.last) ? 1U : 0U;
    }
    for (std::size_t i = 0; i < own.last; ++i) {
      for (std::size_t a = 0; a < at(dims()); ++a) x_[a][i] = sample_.x(a, index_[i]);
      weight_[i] = weighted_ ? sample_.particles.weight[index_[i]] : 1.0;
    }
    return own;
  }

  Box box_of(const Range& own) const {
    Box box;
    for (std::size_t a = 0; a < at(dims()); ++a)
      geometry::least_and_most(std::span(x_[a]).subspan(own.first, own.size()), box.lo[a], box.hi[a]);
    return box;
  }

  void end(const Node& node, const Range& own) {
    ++leaves_;
    if (!node.range.leaf()) out_.ends[at(node.range.node)] = 1;
    const auto p = at(node.range.first);
    out_.inner[p] = node.inner;
    // Of those strictly inside.
    Box seen;
    for (std::size_t i = own.first; i < own.last; ++i) {
      bool inside = true;
      for (std::size_t a = 0; a < at(dims()); ++a) inside &= x_[a][i] > node.inner.lo[a] && x_[a][i] < node.inner.hi[a];
      for (std::size_t a = 0; a < at(dims()); ++a) {
        seen.lo[a] = std::min(seen.lo[a], inside ? x_[a][i] : kInfinity);
        seen.hi[a] = std::max(seen.hi[a], inside ? x_[a][i] : -kInfinity);
      }
    }
    if (!seen.empty(dims())) out_.seen[p].extend(seen);
  }

  void end_open(const Node& node, const Range& own) {
    axis_open_ = true;
    end(node, own);
  }

  void visit(const Node& node, const Range& own, std::span<std::uint32_t> beyond) {
    if (node.range.leaf() || node.level == kGuessLevels || node.leaves == 1 || own.size() == 0) return end(node, own);
    const Order order = order_of(node, own, beyond);
    if (order.first_open) return end_open(node, own);
    const auto a = at(order.axes[0]);
    const Bracket bracket = bracket_of(node, own, order.axes, sigmas_of(node, order.axes));
    if (node.spent + bracket.share > options_.limits.guess.boundary_max || !bracket.bounded) return end(node, own);
    if (bracket.keys.whole && order.others_open) return end_open(node, own);
    out_.brackets[at(node.range.node)] = bracket.keys;
    levels_ += static_cast<double>(own.size()) / static_cast<double>(sample_.count());
    Cut& cut = out_.tree.cuts[at(node.range.node)];
    cut.right_empty = false;
    cut.axes = order.axes;
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
    const std::size_t middle = own.first + bracket.before;
    visit(left, {own.first, middle}, beyond.first(beyond_left));
    visit(right, {middle, own.last}, beyond.subspan(beyond_left));
  }

  // The likeliest axis order. A wrong one costs a search of its node, and at the root a search of everything: so there
  // it is also told what particles outside of the sample might change.
  Order order_of(const Node& node, const Range& own, std::span<const std::uint32_t> beyond) const {
    if (band_axis_ && node.range.node != 0) return {out_.tree.cuts[0].axes, false, false};  // bands have one order
    Box box = node.known != nullptr ? *node.known : box_of(own);
    for (const std::uint32_t k : beyond) box.extend(outermost_->particles.view().point(k), dims());
    Point extents{};
    for (std::size_t a = 0; a < at(dims()); ++a) {
      if (std::isfinite(node.cuts.lo[a])) box.lo[a] = node.cuts.lo[a];
      if (std::isfinite(node.cuts.hi[a])) box.hi[a] = node.cuts.hi[a];
      extents[a] = geometry::extent(box.lo[a], box.hi[a]);
    }
    Order order{geometry::order_by_extent(extents, dims()), false, false};
    if (band_axis_) order.axes = geometry::with_first(order.axes, *band_axis_, dims());
    if (node.level > 0 || node.known != nullptr || outermost_ != nullptr) return order;
    const auto open = [&](std::size_t k) {
      const double reach = 1 + 2 * options_.limits.guess.overhang_max;
      return k < at(dims()) && extents[at(order.axes[k])] * reach > extents[at(order.axes[k - 1])];
    };
    order.first_open = !band_axis_ && open(1);
    order.others_open = open(2);
    return order;
  }

  // A cut that its bracket missed would be missed again: the sample is the same.
  double sigmas_of(const Node& node, const AxisOrder& axes) const {
    const auto n = at(node.range.node);
    const bool missed =
        node.level == 0 && before_ != nullptr && before_->ends[n] == 0 && before_->tree.cuts[n].axes == axes;
    return options_.limits.bracket_sigmas * (missed ? 2 : 1);
  }

  // The bracket of a node's cut; divides the node's sampled particles at the expected one.
  Bracket bracket_of(const Node& node, const Range& own, const AxisOrder& axes, double sigmas) {
    const auto axis = at(axes[0]);
    const double all = size_prefix_[at(node.range.last)] - size_prefix_[at(node.range.first)];
    const double share = (size_prefix_[at(node.range.middle())] - size_prefix_[at(node.range.first)]) / all;
    double load = 0;
    double squares = 0;
    for (std::size_t i = own.first; i < own.last; ++i) {
      load += weight_[i];
      squares += weight_[i] * weight_[i];
    }
    Bracket found{};
    found.variance = (1 - share) * (1 - share) * node.variance_lo[axis] + share * share * node.variance_hi[axis] +
                     share * (1 - share) * squares;
    const double margin =
        sigmas * std::sqrt(found.variance) + options_.limits.bracket_margin * load / static_cast<double>(own.size());
    const double wanted = load * share;
    double before = take_near(own, axis, wanted - margin, wanted + margin);
    // One component of the key after the other, until few are near, or these differ.
    for (std::size_t word = 0; narrow(before, wanted - margin, wanted + margin) && word < at(dims()); ++word)
      for (Valued& one : near_)
        one.x = word + 1 < at(dims()) ? sample_.x(at(axes[word + 1]), one.k)
                                      : static_cast<double>(sample_.particles.id[one.k]);
    keys_.clear();
    for (const Valued& one : near_) keys_.push_back({key(one.k, axes), one.weight});
    std::ranges::sort(keys_, [](const Keyed& a, const Keyed& b) { return a.key < b.key; });
    // Where in keys_ the bracket's ends and the expected cut are; keys_.size() if there is none.
    std::size_t least = keys_.size();
    std::size_t cut = keys_.size();
    std::size_t most = keys_.size();
    for (std::size_t i = 0; i < keys_.size() && most == keys_.size(); ++i) {
      if (before <= wanted - margin) least = i;
      if (before <= wanted) cut = i;
      before += keys_[i].weight;
      if (before >= wanted + margin) most = i;
    }
    if (least == keys_.size() || most == keys_.size()) return found;
    found.keys = {axes, keys_[least].key, keys_[most].key};
    found.cut = keys_[cut].key;
    found.bounded = true;
    const std::size_t between = most - least + 1;
    std::size_t within = 0;
    for (const double value : std::span(x_[axis]).subspan(own.first, own.size()))
      within += (value >= found.keys.least.at[0]) & (value <= found.keys.most.at[0]) ? 1U : 0U;
    const auto size = static_cast<double>(own.size());
    found.keys.whole = static_cast<double>(within - between) > 1 + options_.limits.guess.tied_max * size;
    found.share = static_cast<double>(found.keys.whole ? between : within) / size;
    if (!found.keys.whole) found.cut = key_between(found.cut.at[0], dims());
    found.before = divide(own, axis, found.cut, found.keys.whole ? &axes : nullptr);
    return found;
  }

  // Moves the particles below a cut before the others; returns how many they are. Without branches, which would be
  // mispredicted. axes: if the whole key counts; else null.
  std::size_t divide(const Range& own, std::size_t axis, const Key& cut, const AxisOrder* axes) {
    std::size_t left = 0;
    std::size_t right = 0;
    for (std::size_t i = own.first; i < own.last; ++i) {
      const double x = x_[axis][i];
      bool below = x < cut.at[0];
      if (axes != nullptr && x == cut.at[0]) below = key(index_[i], *axes) < cut;
      left_[left] = right_[right] = static_cast<std::uint32_t>(i);
      left += below ? 1U : 0U;
      right += below ? 0U : 1U;
    }
    std::copy_n(right_.begin(), right, left_.begin() + static_cast<std::ptrdiff_t>(left));
    const auto reorder = [&](auto& values, auto& moved) {
      for (std::size_t i = 0; i < own.size(); ++i) moved[i] = values[left_[i]];
      std::copy_n(moved.begin(), own.size(), values.begin() + static_cast<std::ptrdiff_t>(own.first));
    };
    for (std::size_t a = 0; a < at(dims()); ++a) reorder(x_[a], moved_);
    if (weighted_) reorder(weight_, moved_);
    reorder(index_, right_);
    return left;
  }

  // Fills near_ with those of a node between which the loads from `least` to `most` lie, and more, since narrow()
  // leaves fewer. Returns the load before them.
  double take_near(const Range& own, std::size_t axis, double least, double most) {
    near_.clear();
    const std::span<const double> x = std::span(x_[axis]).subspan(own.first, own.size());
    double lo = kInfinity;
    double hi = -kInfinity;
    geometry::least_and_most(x, lo, hi);
    Bins bins(lo, hi);
    if (own.size() <= at(kBins) || !bins.divides()) bins = Bins(0, 0);
    for (std::size_t i = 0; i < x.size(); ++i) bin_[i] = bins.of(x[i]);
    bins_.fill(0);
    for (std::size_t i = 0; i < x.size(); ++i) bins_[at(bin_[i])] += weight_[own.first + i];
    double before = 0;
    const BinRange within = bins_between(least, most, before);
    for (std::size_t i = 0; i < x.size(); ++i)
      if (within(bin_[i])) near_.push_back({x[i], weight_[own.first + i], index_[own.first + i]});
    return before;
  }

  // Equal steps from lo to hi; all are one if those can't be told.
  struct Bins {
    double start;
    double a_unit;
    Bins(double lo, double hi)
        : start(lo * 0.5), a_unit(lo < hi ? static_cast<double>(kBins) / (hi * 0.5 - start) : 0) {}
    bool divides() const { return a_unit > 0 && std::isfinite(a_unit); }
    std::int32_t of(double x) const {
      return std::min(static_cast<std::int32_t>((x * 0.5 - start) * a_unit), kBins - 1);
    }
  };

  struct BinRange {
    std::int32_t first;
    std::int32_t last;
    // One comparison: whether a bin is below or above `first` can't be predicted.
    bool operator()(std::int32_t bin) const {
      return static_cast<std::uint32_t>(bin - first) <= static_cast<std::uint32_t>(last - first);
    }
  };
  // The bins of the loads from `least` to `most`; adds the load before them.
  BinRange bins_between(double least, double most, double& before) const {
    std::int32_t first = 0;
    while (first + 1 < kBins && before + bins_[at(first)] <= least) before += bins_[at(first++)];
    std::int32_t last = first;
    for (double reached = before + bins_[at(last)]; last + 1 < kBins && reached < most;) reached += bins_[at(++last)];
    return {first, last};
  }

  // Leaves those in near_ between which the loads from `least` to `most` lie, and a few more: sorting all would take
  // longer. Adds the load before them. True if they are many and all have one x.
  bool narrow(double& before, double least, double most) {
    // In equal steps and in steps of the order-preserving bits in turn: where values span decades the former tell few
    // of them apart, and near 0 the latter.
    for (int turn = 0, in_vain = 0; near_.size() > at(kBins) && in_vain < 2; ++turn) {
      const auto place = [turn](double x) { return turn % 2 != 0 ? x : static_cast<double>(geometry::order_bits(x)); };
      const auto [lo, hi] = std::ranges::minmax(near_, {}, &Valued::x);
      if (lo.x == hi.x) return true;
      const std::size_t size = near_.size();
      if (const Bins bins(place(lo.x), place(hi.x)); bins.divides()) {
        bins_.fill(0);
        for (const Valued& one : near_) bins_[at(bins.of(place(one.x)))] += one.weight;
        const BinRange within = bins_between(least, most, before);
        std::erase_if(near_, [&](const Valued& one) { return !within(bins.of(place(one.x))); });
      }
      in_vain = near_.size() == size ? in_vain + 1 : 0;
    }
    return false;
  }

  Key key(std::uint32_t k, const AxisOrder& axes) const {
    return key_of(sample_.particles.view().point(k), sample_.particles.id[k], axes, dims());
  }

  const Sample& sample_;
  const Sample* outermost_;
  const PartitionOptions& options_;
  std::optional<int> band_axis_;
  Guess& out_;
  std::vector<double> size_prefix_;
  bool weighted_ = false;
  const Guess* before_ = nullptr;
  bool axis_open_ = false;
  double levels_ = 0;  // guessed cuts above a particle, on average
  int leaves_ = 0;
  // The sampled particles, those of a node side by side: their places, weights and numbers in the sample.
  std::array<std::vector<double>, geometry::kDimsMax> x_;
  std::vector<double> weight_;
  std::vector<std::uint32_t> index_;
  // For one pass over them.
  std::vector<double> moved_;
  std::vector<std::uint32_t> left_;
  std::vector<std::uint32_t> right_;
  std::vector<std::int32_t> bin_;
  std::vector<std::uint32_t> beyond_;
  std::vector<Valued> near_;
  std::vector<Keyed> keys_;
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
