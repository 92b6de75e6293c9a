#include "common/partition/refine.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

#include "common/base/check.hpp"

namespace rcb::partition {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr std::uint64_t kIdMax = static_cast<std::uint64_t>(std::numeric_limits<Id>::max());

constexpr std::uint64_t kGatherAtOnce = 24;  // so few of a node's particles are gathered without a histogram

std::size_t at(int index) { return static_cast<std::size_t>(index); }

// Every rank handles the whole sample, and its share of what the brackets hold: n / sqrt(sample). The two are in
// balance where the sample grows as (n / ranks)^(2/3); the factor was measured.
std::uint64_t sample_stride(std::uint64_t count, int ranks, const Refinement& refinement) {
  const double share = static_cast<double>(count) / ranks;
  const auto balanced = static_cast<std::uint64_t>(5 * std::cbrt(share) * std::cbrt(share));
  const std::uint64_t wanted = refinement.sample > 0 ? refinement.sample : balanced;
  return std::max<std::uint64_t>(count / std::max<std::uint64_t>(wanted, 1), 1);
}

// The axis that a key's word is of; kDimsMax: the id.
std::size_t axis_of(const SelectNode& ask, std::size_t word, int axes) {
  return word < at(axes) ? at(ask.axes[word]) : std::size_t{geometry::kDimsMax};
}

}  // namespace

Refiner::Refiner(Comm& comm, const particles::ParticleView& particles, const SplitRule& rule,
                 const PartitionOptions& options)
    : comm_(comm),
      particles_(particles),
      rule_(rule),
      refinement_(options.refinement),
      guess_(rule, options.refinement, particles.dims),
      descent_(particles),
      selector_(comm, chosen_view_, rule.axes(), nullptr) {
  chosen_.dims = particles.dims;
}

void Refiner::run(const Bounds& all, CutTree& tree, std::span<std::int32_t> part) {
  tree_ = &tree;
  sample_ = draw_sample(comm_, particles_, sample_stride(rule_.quota(0, tree.parts), comm_.size(), refinement_));
  ++reductions_;
  counts_.sampled = sample_.size();
  frontier_.assign(1, FrontierNode{tree.root(), rule_.axes_of(tree.root(), all), all, 0, sample_.size()});
  while (!frontier_.empty()) {
    pass(part);
    ++counts_.passes;
    start_.swap(next_);
    frontier_.swap(next_frontier_);
  }
  const std::int32_t* const last = start_.data();
  for (std::int32_t& label : part) label = -1 - (label < 0 ? label : last[label]);
}

void Refiner::pass(std::span<std::int32_t> label) {
  guess_.grow(frontier_, sample_);
  const std::size_t nodes = guess_.nodes().size();
  descent_.start(guess_);
  for (std::int32_t& place : start_)
    if (place >= 0) place = guess_.roots()[at(place)];
  waiting_.resize(std::max(waiting_.size(), at(guess_.depth_max()) + 1));
  for (Buffer<Descent::Mover>& level : waiting_) level.clear();
  descent_.run(label, start_, waiting_);
  counts_.scanned += label.size();

  bounds_.assign(nodes, Bounds{});
  below_.assign(nodes, 0);
  inside_.assign(nodes, 0);
  settled_.assign(nodes, 0);
  dead_.assign(nodes, 0);
  next_.assign(2 * nodes, 0);
  next_frontier_.clear();
  for (int depth = 0; depth <= guess_.depth_max(); ++depth) settle_level(depth, label);
  deal_sample();
}

void Refiner::settle_level(int depth, std::span<std::int32_t> label) {
  std::vector<int> level;
  const std::span<const GuessNode> nodes = guess_.nodes();
  for (std::size_t g = 0; g < nodes.size(); ++g) {
    if (nodes[g].depth != depth || dead_[g] != 0) continue;
    if (nodes[g].range.leaf()) {
      next_[g] = -1 - nodes[g].range.first;
      settled_[g] = 1;
    } else {
      level.push_back(static_cast<int>(g));
    }
  }
  measure_level(level);
  count_level(level);
  std::vector<int> asked;
  for (const int g : level) {
    if (!nodes[at(g)].inner) {
      postpone(g, -kInfinity, kInfinity);
    } else if (holds(g)) {
      settled_[at(g)] = 1;
      Cut& cut = tree_->cuts[at(nodes[at(g)].range.node)];
      cut.axes = exact_axes(g);
      cut.right_empty = nodes[at(g)].all_left;
      if (!cut.right_empty) asked.push_back(g);
    }
  }
  if (!asked.empty()) select_level(asked, depth, label);
}

// Exact bounds of a level's nodes where they decide anything: the boxes of all places below each.
void Refiner::measure_level(std::span<const int> nodes) {
  std::vector<int> level;
  for (const int g : nodes) {
    bounds_[at(g)] = guess_.nodes()[at(g)].outer;
    if (!guess_.nodes()[at(g)].certain) level.push_back(g);
  }
  if (level.empty()) return;
  const auto axes = at(rule_.axes());
  std::vector<std::uint64_t> least;
  least.reserve(level.size() * axes * 2);
  for (const int g : level) {
    Descent::Tally box;
    for (const std::size_t shift : {std::size_t{0}, at(descent_.nodes())})
      for (std::size_t place = at(g); place < at(guess_.nodes()[at(g)].end); ++place) {
        const Descent::Tally& tally = descent_.tally(place + shift);
        for (std::size_t a = 0; a < axes; ++a) {
          box.lo[a] = std::min(box.lo[a], tally.lo[a]);
          box.hi[a] = std::max(box.hi[a], tally.hi[a]);
        }
      }
    for (std::size_t a = 0; a < axes; ++a) {
      least.push_back(box.lo[a] <= box.hi[a] ? geometry::image(box.lo[a]) : kNoImage);
      least.push_back(box.lo[a] <= box.hi[a] ? ~geometry::image(box.hi[a]) : kNoImage);
    }
  }
  comm_.all_min(least);
  reductions_ += (least.size() + kMessageWordsMax - 1) / kMessageWordsMax;
  std::size_t word = 0;
  for (const int g : level)
    for (std::size_t a = 0; a < axes; ++a, word += 2) {
      bounds_[at(g)].lo[a] = least[word];
      bounds_[at(g)].not_hi[a] = least[word + 1];
    }
}

void Refiner::count_level(std::span<const int> level) {
  std::vector<std::uint64_t> sums;
  const auto brackets = at(descent_.nodes());
  for (const int g : level) {
    const GuessNode& node = guess_.nodes()[at(g)];
    if (!node.inner || node.all_left) continue;
    std::uint64_t below = 0;
    for (std::size_t place = at(node.left); place < at(node.right); ++place)
      below += descent_.tally(place).count + descent_.tally(place + brackets).count;
    sums.push_back(below);
    sums.push_back(descent_.tally(at(g) + brackets).count);
  }
  if (sums.empty()) return;
  comm_.all_sum(sums);
  reductions_ += (sums.size() + kMessageWordsMax - 1) / kMessageWordsMax;
  std::size_t word = 0;
  for (const int g : level) {
    const GuessNode& node = guess_.nodes()[at(g)];
    if (!node.inner || node.all_left) continue;
    below_[at(g)] = sums[word++];
    inside_[at(g)] = sums[word++];
    counts_.stashed += inside_[at(g)];
  }
}

AxisOrder Refiner::exact_axes(int index) const {
  const GuessNode& node = guess_.nodes()[at(index)];
  return node.certain ? node.axes : rule_.axes_of(node.range, bounds_[at(index)]);
}

bool Refiner::holds(int index) {
  const GuessNode& node = guess_.nodes()[at(index)];
  if (node.all_left) return true;
  const AxisOrder axes = exact_axes(index);
  if (axes[0] != node.axes[0] || (node.whole && axes != node.axes)) {
    ++counts_.wrong_axes;
    postpone(index, -kInfinity, kInfinity);
    return false;
  }
  const std::uint64_t quota = rule_.quota(node.range.first, node.range.middle());
  if (quota >= below_[at(index)] && quota - below_[at(index)] < inside_[at(index)]) return true;
  ++counts_.missed;
  if (quota < below_[at(index)])
    postpone(index, -kInfinity, node.lo);
  else
    postpone(index, node.hi, kInfinity);
  return false;
}

void Refiner::postpone(int node, double side_lo, double side_hi) {
  const auto index = static_cast<std::int32_t>(next_frontier_.size());
  FrontierNode begun;
  begun.range = guess_.nodes()[at(node)].range;
  begun.axes = exact_axes(node);
  begun.bounds = bounds_[at(node)];
  begun.side_lo = side_lo;
  begun.side_hi = side_hi;
  next_frontier_.push_back(begun);
  for (std::size_t g = at(node); g < at(guess_.nodes()[at(node)].end); ++g) {
    dead_[g] = 1;
    next_[g] = next_[g + at(descent_.nodes())] = index;
  }
}

SelectNode Refiner::question(int index) const {
  const GuessNode& node = guess_.nodes()[at(index)];
  const Bounds& bounds = bounds_[at(index)];
  const Cut& cut = tree_->cuts[at(node.range.node)];
  SelectNode ask;
  ask.axes = cut.axes;
  ask.count = inside_[at(index)];
  ask.rank = rule_.quota(node.range.first, node.range.middle()) - below_[at(index)];
  const auto axes = at(rule_.axes());
  for (std::size_t w = 0; w < axes; ++w) {
    const auto axis = static_cast<std::size_t>(cut.axes[w]);
    ask.lo[w] = bounds.lo[axis];
    ask.hi[w] = ~bounds.not_hi[axis];
  }
  ask.lo[axes] = 0;
  ask.hi[axes] = kIdMax;
  // The bracket narrows the first word in which its ends differ, and those before.
  for (std::size_t w = 0; w <= axes && (w == 0 || node.whole); ++w) {
    const auto word = [&](const Key& key) {
      return w == axes ? static_cast<std::uint64_t>(key.id) : geometry::image(key.at[w]);
    };
    if (node.lo > -kInfinity) ask.lo[w] = std::max(ask.lo[w], w == 0 ? geometry::image(node.lo) : word(node.lo_key));
    if (node.hi < kInfinity) ask.hi[w] = std::min(ask.hi[w], w == 0 ? geometry::image(node.hi) : word(node.hi_key));
    if (node.lo == -kInfinity || node.hi == kInfinity || ask.lo[w] != ask.hi[w]) break;
  }
  return ask;
}

void Refiner::select_level(std::span<const int> asked, int depth, std::span<std::int32_t> label) {
  const std::span<const GuessNode> nodes = guess_.nodes();
  std::vector<std::int32_t> slot(nodes.size(), -1);
  std::vector<SelectNode> questions;
  for (const int g : asked) {
    slot[at(g)] = static_cast<std::int32_t>(questions.size());
    questions.push_back(question(g));
  }
  // The level's movers; their place is the number of their question from here on.
  Buffer<Descent::Mover>& movers = waiting_[at(depth)];
  std::size_t kept = 0;
  for (const Descent::Mover& mover : movers) {
    const std::int32_t own = slot[at(mover.place - descent_.nodes())];
    movers[kept] = mover;
    movers[kept].place = own;
    kept += static_cast<std::size_t>(own >= 0);
  }
  movers.resize(kept);
  narrow(questions, movers.span());
  choose_sides(questions, asked, movers.span());
  descent_.go_on(movers.span(), depth + 1, label, waiting_);
  movers.clear();
}

std::size_t Refiner::open_word(const SelectNode& ask) const {
  std::size_t word = 0;
  while (word < at(rule_.axes()) && ask.lo[word] == ask.hi[word]) ++word;
  return word;
}

void Refiner::choose_sides(std::span<SelectNode> questions, std::span<const int> asked,
                           std::span<Descent::Mover> movers) {
  const std::span<const GuessNode> nodes = guess_.nodes();
  struct Sides {
    std::uint64_t lo;
    std::uint64_t span;
    std::size_t axis;
    std::int32_t left;
    std::int32_t right;
  };
  std::vector<Sides> sides;
  for (std::size_t n = 0; n < questions.size(); ++n) {
    const SelectNode& ask = questions[n];
    const GuessNode& node = nodes[at(asked[n])];
    const std::size_t word = words_[n];
    sides.push_back(
        {ask.lo[word], ask.hi[word] - ask.lo[word], axis_of(ask, word, rule_.axes()), node.left, node.right});
  }
  candidates_.clear();
  candidate_node_.clear();
  for (std::size_t k = 0; k < movers.size(); ++k) {
    const std::int32_t own = movers[k].place;
    const Sides& side = sides[at(own)];
    const std::uint64_t word = word_of(movers[k], side.axis);
    movers[k].place = word < side.lo ? side.left : side.right;
    if (word - side.lo > side.span) continue;
    candidates_.push_back(static_cast<std::uint32_t>(k));
    candidate_node_.push_back(own);
  }
  // Those left in the brackets are selected by their whole keys.
  chosen_.resize(candidates_.size());
  for (std::size_t c = 0; c < candidates_.size(); ++c) {
    const Descent::Mover& mover = movers[candidates_[c]];
    for (std::size_t a = 0; a < at(particles_.dims); ++a) chosen_.position[a][c] = mover.at[a];
    chosen_.id[c] = particles_.id[mover.index];
  }
  chosen_view_ = chosen_.view();
  selector_.select(questions, candidate_node_.span());
  for (std::size_t n = 0; n < questions.size(); ++n) {
    CHECK(!questions[n].right_empty, "the bracket holds the cut");
    Cut& cut = tree_->cuts[at(nodes[at(asked[n])].range.node)];
    for (std::size_t w = 0; w < at(rule_.axes()); ++w) cut.key.at[w] = geometry::value_of_image(questions[n].key[w]);
    cut.key.id = static_cast<Id>(questions[n].key[at(rule_.axes())]);
  }
  for (std::size_t c = 0; c < candidates_.size(); ++c) {
    const GuessNode& node = nodes[at(asked[at(candidate_node_[c])])];
    const Cut& cut = tree_->cuts[at(node.range.node)];
    const Key key = key_of(chosen_view_.point(c), chosen_view_.id[c], cut.axes, particles_.dims);
    movers[candidates_[c]].place = key < cut.key ? node.left : node.right;
  }
}

// One histogram of the words that are open, for all nodes of a level together: each bracket becomes the bin that holds
// the cut. A bracket of few particles stays.
void Refiner::narrow(std::span<SelectNode> questions, std::span<const Descent::Mover> movers) {
  struct Probe {
    std::uint64_t lo = kNoImage;
    std::uint64_t span = 0;
    unsigned shift = 63;
    std::size_t axis = 0;
    std::size_t cells = 0;
  };
  std::uint64_t inside_max = 0;
  std::size_t count = 0;
  const auto worthwhile = [](const SelectNode& ask) { return ask.count > kGatherAtOnce; };
  words_.clear();
  for (const SelectNode& ask : questions) words_.push_back(open_word(ask));
  for (const SelectNode& ask : questions)
    if (worthwhile(ask)) {
      inside_max = std::max(inside_max, ask.count);
      ++count;
    }
  if (count == 0) return;
  // As many bins as one message holds; with many nodes about as many as balance the histogram and what is gathered.
  const auto balanced = static_cast<std::size_t>(std::sqrt(5 * static_cast<double>(inside_max)));
  const std::size_t bins = std::max(std::bit_ceil(std::clamp<std::size_t>(balanced, 16, 256)),
                                    std::bit_floor(kMessageWordsMax / std::min(count, kMessageWordsMax)));
  const auto bin_bits = static_cast<unsigned>(std::bit_width(bins) - 1);
  std::vector<Probe> probes(questions.size());
  std::size_t cells = bins;  // the first are for particles of nodes that stay as they are
  for (std::size_t n = 0; n < questions.size(); ++n) {
    if (!worthwhile(questions[n])) continue;
    const std::size_t word = words_[n];
    const std::uint64_t span = questions[n].hi[word] - questions[n].lo[word];
    const auto width = static_cast<unsigned>(std::bit_width(span));
    probes[n] = {questions[n].lo[word], span, width > bin_bits ? width - bin_bits : 0,
                 axis_of(questions[n], word, rule_.axes()), cells};
    cells += bins;
  }
  histogram_.resize(cells);
  std::fill(histogram_.begin(), histogram_.end(), 0);
  for (const Descent::Mover& mover : movers) {
    const Probe& probe = probes[at(mover.place)];
    ++histogram_[probe.cells + (std::min(word_of(mover, probe.axis) - probe.lo, probe.span) >> probe.shift)];
  }
  const std::span<std::uint64_t> sums = histogram_.span().subspan(bins);
  for (std::size_t first = 0; first < sums.size(); first += kMessageWordsMax) {
    comm_.all_sum(sums.subspan(first, std::min(kMessageWordsMax, sums.size() - first)));
    ++rounds_;
    ++reductions_;
  }
  for (std::size_t n = 0; n < questions.size(); ++n) {
    const Probe& probe = probes[n];
    SelectNode& ask = questions[n];
    if (probe.cells == 0) continue;
    std::uint64_t bin = 0;
    while (ask.rank >= histogram_[probe.cells + bin]) {
      ask.rank -= histogram_[probe.cells + bin];
      ++bin;
      CHECK(bin < bins, "the bracket holds the cut");
    }
    ask.count = histogram_[probe.cells + bin];
    std::uint64_t& lo = ask.lo[words_[n]];
    std::uint64_t& hi = ask.hi[words_[n]];
    lo += bin << probe.shift;
    hi = std::min(hi - lo, (std::uint64_t{1} << probe.shift) - 1) + lo;
  }
}

// The sample's points of every node that begins the next pass, by the exact cuts so far.
void Refiner::deal_sample() {
  if (next_frontier_.empty()) return;
  const std::span<const GuessNode> nodes = guess_.nodes();
  std::vector<std::int32_t> place(sample_.size(), -1);
  for (std::size_t f = 0; f < frontier_.size(); ++f)
    for (std::size_t s = frontier_[f].sample_first; s < frontier_[f].sample_last; ++s) {
      auto g = at(guess_.roots()[f]);
      while (settled_[g] != 0 && !nodes[g].range.leaf()) {
        const Cut& cut = tree_->cuts[at(nodes[g].range.node)];
        const SamplePoint& point = sample_[s];
        const double value = point.at[static_cast<std::size_t>(cut.axes[0])];
        const bool right =
            !cut.right_empty &&
            (value > cut.key.at[0] ||
             (value == cut.key.at[0] && !(key_of(point.at, point.id, cut.axes, particles_.dims) < cut.key)));
        g = at(right ? nodes[g].right : nodes[g].left);
      }
      place[s] = next_[g];
    }
  std::vector<std::size_t> end(next_frontier_.size() + 1, 0);
  for (const std::int32_t f : place)
    if (f >= 0) ++end[at(f) + 1];
  for (std::size_t f = 0; f < next_frontier_.size(); ++f) {
    end[f + 1] += end[f];
    next_frontier_[f].sample_first = end[f];
    next_frontier_[f].sample_last = end[f + 1];
  }
  std::vector<SamplePoint> dealt(end.back());
  for (std::size_t s = 0; s < sample_.size(); ++s)
    if (place[s] >= 0) dealt[end[at(place[s])]++] = sample_[s];
  sample_.swap(dealt);
}

}  // namespace rcb::partition
