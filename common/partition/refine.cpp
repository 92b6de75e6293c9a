#include "common/partition/refine.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "common/base/check.hpp"

namespace rcb::partition {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr std::uint64_t kIdMax = static_cast<std::uint64_t>(std::numeric_limits<Id>::max());

std::size_t at(int index) { return static_cast<std::size_t>(index); }

}  // namespace

// Every rank handles the whole sample, and its share of what the brackets hold: n / sqrt(sample). The two are in
// balance where the sample grows as (n / ranks)^(2/3); the factor was measured.
std::uint64_t balanced_sample(std::uint64_t count, int ranks) {
  const double share = static_cast<double>(count) / ranks;
  return static_cast<std::uint64_t>(5 * std::cbrt(share) * std::cbrt(share));
}

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
  const std::uint64_t count = rule_.quota(0, tree.parts);
  const std::uint64_t wanted = refinement_.sample > 0 ? refinement_.sample : balanced_sample(count, comm_.size());
  sample_ = draw_sample(comm_, particles_, std::max<std::uint64_t>(count / std::max<std::uint64_t>(wanted, 1), 1));
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
  std::vector<double> expected(waiting_.size(), 0);
  for (const GuessNode& node : guess_.nodes())
    if (node.inner && !node.all_left) expected[at(node.depth)] += node.expected / comm_.size();
  for (std::size_t depth = 0; depth < waiting_.size(); ++depth) {
    waiting_[depth].clear();
    const double room = std::min(1.05 * expected[depth], static_cast<double>(label.size()));
    waiting_[depth].reserve(static_cast<std::size_t>(room));
  }
  descent_.run(label, start_, waiting_);
  counts_.scanned += label.size();

  bounds_.assign(nodes, Bounds{});
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
  std::vector<int> asked;
  for (const int g : level) {
    if (!nodes[at(g)].inner) {
      postpone(g, -kInfinity, kInfinity);
      continue;
    }
    if (!order_holds(g)) continue;
    Cut& cut = tree_->cuts[at(nodes[at(g)].range.node)];
    cut.axes = exact_axes(g);
    cut.right_empty = nodes[at(g)].all_left;
    if (cut.right_empty)
      settled_[at(g)] = 1;
    else
      asked.push_back(g);
  }
  if (!asked.empty()) select_level(std::move(asked), depth, label);
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

AxisOrder Refiner::exact_axes(int index) const {
  const GuessNode& node = guess_.nodes()[at(index)];
  return node.certain ? node.axes : rule_.axes_of(node.range, bounds_[at(index)]);
}

// Whether the axis order was guessed right, as far as the guess used it; if not, the node begins the next pass.
bool Refiner::order_holds(int index) {
  const GuessNode& node = guess_.nodes()[at(index)];
  const AxisOrder axes = exact_axes(index);
  if (axes[0] == node.axes[0] && (!node.whole || axes == node.axes)) return true;
  ++counts_.wrong_axes;
  postpone(index, -kInfinity, kInfinity);
  return false;
}

// Whether the bracket holds the cut; if not, the node begins the next pass with the side known.
bool Refiner::bracket_holds(int index, std::uint64_t below, std::uint64_t inside) {
  const GuessNode& node = guess_.nodes()[at(index)];
  const std::uint64_t quota = rule_.quota(node.range.first, node.range.middle());
  if (quota >= below && quota - below < inside) return true;
  ++counts_.missed;
  const bool root = guess_.roots()[at(node.root)] == index;
  const double side_lo = root ? frontier_[at(node.root)].side_lo : -kInfinity;
  const double side_hi = root ? frontier_[at(node.root)].side_hi : kInfinity;
  quota < below ? postpone(index, side_lo, node.lo) : postpone(index, node.hi, side_hi);
  next_frontier_.back().misses = root ? frontier_[at(node.root)].misses + 1 : 1;
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

void Refiner::select_level(std::vector<int> asked, int depth, std::span<std::int32_t> label) {
  Buffer<Descent::Mover>& movers = waiting_[at(depth)];
  std::vector<SelectNode> questions;
  // From here on a mover's place is the number of its question.
  std::vector<std::int32_t> number(guess_.nodes().size(), -1);
  for (const int g : asked) {
    number[at(g)] = static_cast<std::int32_t>(questions.size());
    questions.push_back(question(g));
  }
  renumber(movers, number, descent_.nodes());
  count_and_narrow(questions, asked, movers.span());
  if (std::ranges::find(asked, -1) != asked.end()) {  // brackets missed
    std::size_t kept = 0;
    number.assign(asked.size(), -1);
    for (std::size_t n = 0; n < asked.size(); ++n) {
      if (asked[n] < 0) continue;
      number[n] = static_cast<std::int32_t>(kept);
      asked[kept] = asked[n];
      words_[kept] = words_[n];
      questions[kept++] = questions[n];
    }
    asked.resize(kept);
    questions.resize(kept);
    renumber(movers, number, 0);
  }
  candidates_.resize(movers.size());
  std::iota(candidates_.begin(), candidates_.end(), 0U);
  choose_sides(questions, asked, movers.span());
  // One round a word: what is left is for the Selector, whose rounds are bounded.
  for (int round = 0; round < rule_.axes() && narrow_again(questions, movers.span()); ++round)
    choose_sides(questions, asked, movers.span());
  select_candidates(questions, asked, movers.span());
  descent_.go_on(movers.span(), depth + 1, label, waiting_);
  movers.clear();
}

// Gives every mover the number of its question; those without one stay where they are: their node begins the next pass.
void Refiner::renumber(Buffer<Descent::Mover>& movers, std::span<const std::int32_t> number, int shift) {
  std::size_t kept = 0;
  bool all = true;
  for (Descent::Mover& mover : movers) {
    mover.place = number[at(mover.place - shift)];
    all &= mover.place >= 0;
  }
  if (all) return;
  for (const Descent::Mover& mover : movers) {
    movers[kept] = mover;
    kept += static_cast<std::size_t>(mover.place >= 0);
  }
  movers.resize(kept);
}

// The movers outside of the narrowed brackets know their sides; the others are the candidates.
void Refiner::choose_sides(std::span<const SelectNode> questions, std::span<const int> asked,
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
    sides.push_back({ask.lo[word], ask.hi[word] - ask.lo[word], axis_of(ask, word), node.left, node.right});
  }
  std::size_t kept = 0;
  for (const std::uint32_t k : candidates_) {
    const std::int32_t own = movers[k].place;
    const Sides& side = sides[at(own)];
    const std::uint64_t word = word_of(movers[k], side.axis);
    const bool inside = word - side.lo <= side.span;
    movers[k].place = inside ? own : word < side.lo ? side.left : side.right;
    candidates_[kept] = k;
    kept += static_cast<std::size_t>(inside);
  }
  candidates_.resize(kept);
}

// Selects the cuts among the candidates by their whole keys.
void Refiner::select_candidates(std::span<SelectNode> questions, std::span<const int> asked,
                                std::span<Descent::Mover> movers) {
  const std::span<const GuessNode> nodes = guess_.nodes();
  candidate_node_.clear();
  for (const std::uint32_t k : candidates_) candidate_node_.push_back(movers[k].place);
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
