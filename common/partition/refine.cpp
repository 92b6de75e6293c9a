#include "common/partition/refine.hpp"

#include <algorithm>

#include "common/base/check.hpp"

namespace rcb::partition {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr std::uint64_t kIdMax = static_cast<std::uint64_t>(std::numeric_limits<Id>::max());

std::size_t at(int index) { return static_cast<std::size_t>(index); }

std::uint64_t sample_stride(std::uint64_t count, const Refinement& refinement) {
  return std::max<std::uint64_t>(count / std::max<std::uint64_t>(refinement.sample, 1), 1);
}

}  // namespace

Refiner::Refiner(Comm& comm, const particles::ParticleView& particles, const SplitRule& rule,
                 const PartitionOptions& options)
    : comm_(comm),
      particles_(particles),
      rule_(rule),
      refinement_(options.refinement),
      guess_(rule, options.refinement, particles.dims),
      descent_(particles, !rule.fixed()),
      selector_(comm, waiting_view_, rule.axes(), nullptr) {
  waiting_.dims = particles.dims;
}

void Refiner::run(const Bounds& all, CutTree& tree, std::span<std::int32_t> part) {
  tree_ = &tree;
  sample_ = draw_sample(comm_, particles_, sample_stride(rule_.quota(0, tree.parts), refinement_));
  ++reductions_;
  counts_.sampled = sample_.size();
  frontier_.assign(1, FrontierNode{tree.root(), all, 0, sample_.size()});
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
  stopped_.clear();
  descent_.run(label, start_, stopped_);
  counts_.scanned += label.size();
  sort_stopped(label);

  bounds_.assign(nodes, Bounds{});
  below_.assign(nodes, 0);
  inside_.assign(nodes, 0);
  settled_.assign(nodes, 0);
  dead_.assign(nodes, 0);
  next_.assign(2 * nodes, 0);
  next_frontier_.clear();
  for (std::size_t f = 0; f < frontier_.size(); ++f) bounds_[at(guess_.roots()[f])] = frontier_[f].bounds;
  for (int depth = 0; depth <= guess_.depth_max(); ++depth) settle_level(depth, label);
  deal_sample();
}

void Refiner::wait(std::size_t particle, std::int32_t place) {
  if (place < descent_.nodes()) return;
  levels_[at(guess_.nodes()[at(place - descent_.nodes())].depth)].push_back(static_cast<std::uint32_t>(particle));
}

void Refiner::sort_stopped(std::span<std::int32_t> label) {
  levels_.resize(std::max(levels_.size(), at(guess_.depth_max()) + 1));
  for (Buffer<std::uint32_t>& level : levels_) level.clear();
  for (const std::uint32_t i : stopped_) {
    const GuessNode& node = guess_.nodes()[at(label[i] - descent_.nodes())];
    const std::int32_t next = node.whole ? descent_.decide(i, node) : -1;
    if (next >= 0) {
      descent_.leave(label[i]);
      label[i] = descent_.go_on(i, next);
    }
    wait(i, label[i]);
  }
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
  if (depth > 0) measure_level(level);
  count_level(level);
  std::vector<int> asked;
  for (const int g : level) {
    if (!nodes[at(g)].inner) {
      postpone(g, -kInfinity, kInfinity);
    } else if (holds(g)) {
      settled_[at(g)] = 1;
      Cut& cut = tree_->cuts[at(nodes[at(g)].range.node)];
      cut.axes = rule_.axes_of(nodes[at(g)].range, bounds_[at(g)]);
      cut.right_empty = nodes[at(g)].all_left;
      if (!cut.right_empty) asked.push_back(g);
    }
  }
  if (!asked.empty()) select_level(asked, depth, label);
}

// Exact bounds of a level's nodes: the boxes of all places below each.
void Refiner::measure_level(std::span<const int> level) {
  if (level.empty()) return;
  if (rule_.fixed()) {  // only the order of the axes matters, and that is known
    for (const int g : level) bounds_[at(g)] = frontier_[at(guess_.nodes()[at(g)].root)].bounds;
    return;
  }
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

bool Refiner::holds(int index) {
  const GuessNode& node = guess_.nodes()[at(index)];
  if (node.all_left) return true;
  const AxisOrder axes = rule_.axes_of(node.range, bounds_[at(index)]);
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
  const auto brackets = descent_.nodes();
  Buffer<std::uint32_t>& level = levels_[at(depth)];
  std::vector<std::int32_t> slot(nodes.size(), -1);
  std::vector<SelectNode> questions;
  for (const int g : asked) {
    slot[at(g)] = static_cast<std::int32_t>(questions.size());
    questions.push_back(question(g));
  }
  waiting_.resize(level.size());
  Buffer<std::int32_t> node_of(level.size());
  std::size_t kept = 0;
  for (const std::uint32_t i : level) {
    const std::int32_t place = slot[at(label[i] - brackets)];
    if (place < 0) continue;
    for (std::size_t a = 0; a < at(particles_.dims); ++a) waiting_.position[a][kept] = particles_.position[a][i];
    waiting_.id[kept] = particles_.id[i];
    node_of[kept] = place;
    level[kept++] = i;
  }
  waiting_.resize(kept);
  node_of.resize(kept);
  waiting_view_ = waiting_.view();
  selector_.select(questions, node_of.span());

  for (std::size_t n = 0; n < questions.size(); ++n) {
    CHECK(!questions[n].right_empty, "the bracket holds the cut");
    Cut& cut = tree_->cuts[at(nodes[at(asked[n])].range.node)];
    for (std::size_t w = 0; w < at(rule_.axes()); ++w) cut.key.at[w] = geometry::value_of_image(questions[n].key[w]);
    cut.key.id = static_cast<Id>(questions[n].key[at(rule_.axes())]);
  }
  for (std::size_t k = 0; k < kept; ++k) {
    const std::size_t i = level[k];
    const GuessNode& node = nodes[at(asked[at(node_of[k])])];
    const Cut& cut = tree_->cuts[at(node.range.node)];
    const double value = waiting_.position[at(cut.axes[0])][k];
    bool right = value > cut.key.at[0];
    if (value == cut.key.at[0]) [[unlikely]]
      right = !(key_of(waiting_view_.point(k), waiting_view_.id[k], cut.axes, particles_.dims) < cut.key);
    label[i] = descent_.go_on(i, right ? node.right : node.left);
    wait(i, label[i]);
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
        const bool right = !cut.right_empty && !(key_of(point.at, point.id, cut.axes, particles_.dims) < cut.key);
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
