#include "common/partition/incremental/guess.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "common/base/index.hpp"
#include "common/partition/search/outermost.hpp"

namespace rcb::partition {
namespace {

using geometry::Box;

// Descends from the root; each node gets the sampled particles that the guessed cuts above leave it.
class SampleWalk {
 public:
  SampleWalk(SortedSample sorted, const PartitionOptions& options, const SplitRule& rule, Guess& out)
      : sample_(sorted.sample()), sorted_(std::move(sorted)), options_(options), rule_(rule), out_(out) {
    if (!rule_.known()) rule_.set_all(sample_.count(), sorted_.extents(sorted_.all()));
    const auto& weight = sample_.particles.weight;
    weighted_ = std::ranges::any_of(weight, [&](double w) { return w != weight[0]; });
  }

  void run(const GuessRoots& below) {
    before_ = below.before;
    std::vector<std::int32_t> part;
    if (below.roots.size() > 1 || below.roots[0].parts() < options_.parts) {
      part.resize(sample_.count());
      below.tree.classify(sample_.particles.view(), part);
    }
    std::size_t first = 0;
    for (std::size_t r = 0; r < below.roots.size(); ++r) {
      Node root;
      root.range = below.roots[r];
      root.inner = Box::unbounded();
      root.known = below.boxes.empty() ? nullptr : &below.boxes[r];
      const auto in_root = [&](std::uint32_t k) { return part[k] >= root.range.first && part[k] < root.range.last; };
      // This range has none of the outermost particles, so it does not matter where these would be divided.
      const Range own = part.empty() ? sorted_.all() : sorted_.divide({first, sample_.count()}, 0, 0, in_root).left;
      first = own.last;
      visit(root, own);
    }
    // A pass over all particles that cuts few of them would cost more than it saves.
    out_.found = levels_ > 0 && levels_ >= options_.limits.guess.levels_min * (part.empty() ? 1.0 : 0.1);
  }

 private:
  struct Node {
    NodeRange range;
    Box inner;
    // Variance of the load below a face that is a cut, in the square of the sample's unit; 0: the face isn't a cut.
    Point variance_lo{};
    Point variance_hi{};
    double spent = 0;            // share of the particles on the brackets above
    const Box* known = nullptr;  // of all its particles; null: not known
  };
  using Range = SortedSample::Range;
  struct Keyed {
    Key key;
    double weight;
  };
  struct Bracket {
    KeyBracket keys;
    SortedSample::Halves halves;
    double variance;
    double share;  // of the sampled particles in the bracket
  };
  // Among sampled particles in the order of a cut: those at a bracket's ends, and the first one above the expected cut.
  struct Places {
    std::size_t least;
    std::size_t cut;
    std::size_t most;
    std::size_t between() const { return most - least + 1; }
  };

  int dims() const { return sample_.particles.dims; }

  double weight(std::uint32_t k) const { return weighted_ ? sample_.particles.weight[k] : 1.0; }

  void end(const Node& node, const Range& own) {
    const auto p = at(node.range.first);
    out_.inner[p] = node.inner;
    // Of those strictly inside: the outermost in the order of each axis.
    const auto inside = [&](std::uint32_t k) {
      bool all = true;
      for (std::size_t a = 0; a < at(dims()); ++a)
        all &= sample_.x(a, k) > node.inner.lo[a] && sample_.x(a, k) < node.inner.hi[a];
      return all;
    };
    for (std::size_t a = 0; a < at(dims()); ++a) {
      const std::span<const std::uint32_t> sorted = sorted_.particles(own, a);
      const auto first = std::ranges::find_if(sorted, inside);
      if (first == sorted.end()) return;
      const auto last = std::find_if(sorted.rbegin(), sorted.rend(), inside);
      out_.seen[p].lo[a] = sample_.x(a, *first);
      out_.seen[p].hi[a] = sample_.x(a, *last);
      out_.tied |= first + 1 < sorted.end() && sample_.x(a, first[1]) == sample_.x(a, *first);
      out_.tied |= last + 1 < sorted.rend() && sample_.x(a, last[1]) == sample_.x(a, *last);
    }
  }

  void visit(const Node& node, const Range& own) {
    if (node.range.leaf() || own.size() == 0) return end(node, own);
    const AxisOrder axes = order_of(node, own);
    const auto a = at(axes[0]);
    // A wrong axis costs a search of its node, which at the root is a search of everything. So there it must be sure.
    const bool known = node.range.node != 0 || node.known != nullptr || sorted_.has_outermost();
    const OpenOrder open = known ? OpenOrder{} : open_order(sorted_, axes, options_.limits.guess.overhang);
    const Bracket bracket = bracket_of(node, own, axes, sigmas_of(node, axes));
    if (node.spent + bracket.share > options_.limits.guess.boundary_max || !bracket.keys.known) return end(node, own);
    if ((open.first && options_.method == Method::rcb) || (open.others && bracket.keys.whole)) {
      out_.open = true;
      out_.sides = {sorted_.box(bracket.halves.left), sorted_.box(bracket.halves.right)};
      return end(node, own);
    }
    out_.brackets[at(node.range.node)] = bracket.keys;
    levels_ += static_cast<double>(own.size()) / static_cast<double>(sample_.count());
    Node left = node;
    Node right = node;
    left.range = node.range.left();
    right.range = node.range.right();
    left.known = right.known = nullptr;
    left.spent = right.spent = node.spent + bracket.share;
    left.inner.hi[a] = std::min(node.inner.hi[a], bracket.keys.least.at[0]);
    right.inner.lo[a] = std::max(node.inner.lo[a], bracket.keys.most.at[0]);
    left.variance_hi[a] = right.variance_lo[a] = bracket.variance;
    visit(left, bracket.halves.left);
    visit(right, bracket.halves.right);
  }

  // The likeliest axis order.
  AxisOrder order_of(const Node& node, const Range& own) const {
    const Box box = node.known != nullptr ? *node.known : sorted_.box(own);
    Point extents{};
    for (std::size_t a = 0; a < at(dims()); ++a) extents[a] = geometry::extent(box.lo[a], box.hi[a]);
    return *rule_.axes_of(node.range, {extents, extents});
  }

  // A cut that its bracket missed would be missed again: the sample is the same.
  double sigmas_of(const Node& node, const AxisOrder& axes) const {
    const auto n = at(node.range.node);
    const bool missed = node.known != nullptr && before_->brackets[n].known && before_->brackets[n].axes == axes;
    return options_.limits.bracket_sigmas * (missed ? 2 : 1);
  }

  // The bracket of a node's cut; divides the node's sampled particles at the expected one.
  Bracket bracket_of(const Node& node, const Range& own, const AxisOrder& axes, double sigmas) {
    const auto axis = at(axes[0]);
    const double share = rule_.left_share(node.range);
    const std::span<const std::uint32_t> sorted = sorted_.particles(own, axis);
    const auto size = static_cast<double>(own.size());
    double load = weighted_ ? 0 : size;
    double squares = load;
    for (std::size_t k = 0; k < sorted.size() && weighted_; ++k) {
      load += weight(sorted[k]);
      squares += weight(sorted[k]) * weight(sorted[k]);
    }
    Bracket found{};
    found.variance = (1 - share) * (1 - share) * node.variance_lo[axis] + share * share * node.variance_hi[axis] +
                     share * (1 - share) * squares;
    const double margin = sigmas * std::sqrt(found.variance) + options_.limits.bracket_margin * load / size;
    const double wanted = load * share;
    const auto by_x = places(own.size(), 0, wanted, margin, [&](std::size_t i) { return weight(sorted[i]); });
    if (!by_x) return found;
    const auto tied = [&](std::size_t within, const Places& place) {
      return static_cast<double>(within - place.between()) > 1 + options_.limits.guess.tied_max * size;
    };
    // By rounded coordinates, unless too many are equal.
    const double cut = sorted_.x(own, axis, by_x->cut);
    found.keys = {true, axes, key(sorted[by_x->least], axes), key(sorted[by_x->most], axes)};
    const std::size_t first = sorted_.below(own, axis, found.keys.least.at[0]);
    const std::size_t last = sorted_.up_to(own, axis, found.keys.most.at[0]);
    if (!tied(last - first, *by_x) && found.keys.least.at[0] <= cut && cut <= found.keys.most.at[0]) {
      // Equal ones are in any order.
      for (const std::uint32_t k : sorted.subspan(first, by_x->least - first))
        found.keys.least = std::min(found.keys.least, key(k, axes));
      for (const std::uint32_t k : sorted.subspan(by_x->most, last - by_x->most))
        found.keys.most = std::max(found.keys.most, key(k, axes));
      found.share = static_cast<double>(last - first) / size;
      found.halves = sorted_.split(own, axis, by_x->cut);
      return found;
    }
    take_keys(sorted.subspan(first, last - first), axes, {by_x->most - first, by_x->cut - first, by_x->least - first});
    double before = 0;
    for (const std::uint32_t k : sorted.first(first)) before += weight(k);
    const auto by_key = places(keys_.size(), before, wanted, margin, [&](std::size_t i) { return keys_[i].weight; });
    if (!by_key) return {};  // weights in another order may have another sum
    found.keys = {true, axes, keys_[by_key->least].key, keys_[by_key->most].key};
    const Key expected = keys_[by_key->cut].key;
    const auto within = static_cast<std::size_t>(std::ranges::count_if(keys_, [&](const Keyed& one) {
      return one.key.at[0] >= found.keys.least.at[0] && one.key.at[0] <= found.keys.most.at[0];
    }));
    found.keys.whole = tied(within, *by_key);
    found.share = static_cast<double>(found.keys.whole ? by_key->between() : within) / size;
    found.halves = sorted_.divide(own, axis, expected.at[0], [&](std::uint32_t k) {
      const double x = sample_.x(axis, k);
      return x < expected.at[0] || (found.keys.whole && x == expected.at[0] && key(k, axes) < expected);
    });
    return found;
  }

  // Fills keys_, ascending if there are weights. Else only the keys in these three places, which descend, are what a
  // sort would put there.
  void take_keys(std::span<const std::uint32_t> particles, const AxisOrder& axes,
                 const std::array<std::size_t, 3>& places) {
    keys_.clear();
    for (const std::uint32_t k : particles) keys_.push_back({key(k, axes), weight(k)});
    const auto less = [](const Keyed& a, const Keyed& b) { return a.key < b.key; };
    if (weighted_) {
      std::ranges::sort(keys_, less);
      return;
    }
    auto end = keys_.end();
    for (const std::size_t place : places) {
      const auto nth = keys_.begin() + static_cast<std::ptrdiff_t>(place);
      std::ranges::nth_element(keys_.begin(), nth, end, less);
      end = nth;
    }
  }

  // nullopt if these loads don't reach from wanted - margin to wanted + margin.
  //   before   load before the first one
  //   load_of  of the i-th; not called where all are 1
  template <typename LoadOf>
  std::optional<Places> places(std::size_t count, double before, double wanted, double margin, LoadOf load_of) const {
    if (!weighted_) {
      const double most = std::max(std::ceil(wanted + margin - before) - 1, 0.0);
      if (!(wanted - margin >= before) || !(most < static_cast<double>(count))) return std::nullopt;
      const auto place = [&](double k) { return static_cast<std::size_t>(std::min(k, most)); };
      return Places{place(wanted - margin - before), place(wanted - before), place(most)};
    }
    Places found{.least = count};
    for (std::size_t i = 0; i < count; ++i) {
      if (before <= wanted - margin) found.least = i;
      if (before <= wanted) found.cut = i;
      before += load_of(i);
      if (before < wanted + margin) continue;
      found.most = i;
      return found.least < count ? std::optional(found) : std::nullopt;
    }
    return std::nullopt;
  }

  Key key(std::uint32_t k, const AxisOrder& axes) const {
    return key_of(sample_.particles.view().point(k), sample_.particles.id[k], axes, dims());
  }

  const Sample& sample_;
  SortedSample sorted_;
  const PartitionOptions& options_;
  SplitRule rule_;
  Guess& out_;
  bool weighted_ = false;
  const Guess* before_ = nullptr;
  double levels_ = 0;  // guessed cuts above a particle, on average
  std::vector<Keyed> keys_;
};

}  // namespace

Guess guess_cuts(const SortedSample& sample, const PartitionOptions& options, const GuessRoots& below) {
  RCB_CHECK(at(options.parts) <= kGuessParts, "a guess has few parts");
  Guess guess{.parts = options.parts};
  guess.inner.fill(Box::unbounded());
  SampleWalk(sample, options, below.rule, guess).run(below);
  return guess;
}

}  // namespace rcb::partition
