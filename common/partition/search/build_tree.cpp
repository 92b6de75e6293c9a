#include "common/partition/search/build_tree.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

#include "common/base/index.hpp"
#include "common/comm/gather.hpp"
#include "common/comm/wide_sum.hpp"

namespace rcb::partition {
namespace {

constexpr std::uint64_t kNoOrderBits = ~std::uint64_t{0};

}  // namespace

CutTree uncut_tree(const PartitionOptions& options, int dims) {
  CutTree tree;
  tree.dims = dims;
  tree.method = options.method;
  tree.parts = options.parts;
  tree.part_sizes = options.part_sizes;
  tree.cuts.resize(at(options.parts) - 1);
  return tree;
}

std::vector<std::int32_t> roots_of_parts(std::span<const NodeRange> roots, int parts) {
  std::vector<std::int32_t> root_of(at(parts), Roots::kNone);
  for (std::size_t r = 0; r < roots.size(); ++r)
    std::fill(root_of.begin() + roots[r].first, root_of.begin() + roots[r].last, static_cast<std::int32_t>(r));
  return root_of;
}

TreeBuilder::TreeBuilder(comm::Comm& comm, const particles::ParticleView& particles, const PartitionOptions& options,
                         Start start)
    : comm_(comm),
      particles_(particles),
      options_(options),
      axes_(particles.dims),
      start_(std::move(start)),
      interior_(start_.interior),
      rule_(start_.rule != nullptr ? *start_.rule : SplitRule(options, particles.dims)),
      scale_(start_.scale) {
  result_.tree = start_.tree != nullptr ? *start_.tree : uncut_tree(options, particles.dims);
  if (start_.roots.empty()) start_.roots = {result_.tree.root()};
  // (1 + level tolerance)^levels <= 1 + tolerance
  const double levels = std::bit_width(static_cast<unsigned>(options.parts - 1));
  level_tolerance_ = std::expm1(std::log1p(options.cut_tolerance) / std::max(levels, 1.0));
}

std::optional<PartitionResult> TreeBuilder::build(const comm::GoOn& go_on) {
  if (start_.part.empty()) {
    result_.part.resize(particles_.count);
    start_.part = result_.part.span();
  }
  if (options_.parts == 1) {
    std::ranges::fill(start_.part, 0);
    return std::move(result_);
  }
  measure_all();
  if (!scale_) result_.counts.resize(at(options_.parts));
  quantise();
  lay_out_roots();
  Selector selector(comm_, particles_, maps_, scale_ ? &*scale_ : nullptr, options_.limits, result_);
  std::vector<CutRequest> wanted;
  while (!level_.empty()) {
    if (go_on && !go_on()) return std::nullopt;
    order_axes();
    if (sampled()) expect_other_axes();
    wanted.clear();
    for (const Node& node : level_) wanted.push_back(request_of(node));
    split(wanted, selector.select(wanted));
    if (failed_count_ > start_.failed_max) return std::nullopt;
    level_.swap(next_);
    spans_.swap(next_spans_);
  }
  result_.traffic.bytes += writer_.write(start_.part);
  std::ranges::sort(uncut_, {}, &NodeRange::first);
  return std::move(result_);
}

Extents TreeBuilder::extents_of(const Node& node) const {
  Extents extents;
  const QBounds& bounds = node.bounds;
  const geometry::Box interior = interior_box(node.range);
  const bool none = interior.empty(axes_);
  for (std::size_t a = 0; a < at(axes_); ++a) {
    const AxisMap& map = maps_[a];
    if (bounds.empty() && none) continue;
    // lo and hi: intervals that hold the least and the greatest coordinate.
    std::array<double, 2> lo{interior.lo[a], interior.lo[a]};
    std::array<double, 2> hi{interior.hi[a], interior.hi[a]};
    if (!bounds.empty()) {
      lo = {std::min(lo[0], map.least(bounds.lo[a])), std::min(lo[1], map.most(bounds.lo[a]))};
      hi = {std::max(hi[0], map.least(bounds.hi[a])), std::max(hi[1], map.most(bounds.hi[a]))};
    }
    extents.least[a] = std::max(geometry::extent(lo[1], hi[0]), 0.0);
    extents.most[a] = geometry::extent(lo[0], hi[1]);
  }
  return extents;
}

bool TreeBuilder::one_lossless_place(const QBounds& bounds) const {
  if (bounds.empty()) return false;
  for (std::size_t a = 0; a < at(axes_); ++a)
    if (!maps_[a].lossless() || bounds.lo[a] != bounds.hi[a]) return false;
  return true;
}

void TreeBuilder::order_axes() {
  std::vector<std::size_t> open;
  for (std::size_t n = 0; n < level_.size(); ++n) {
    Node& node = level_[n];
    node.coincident = node.coincident || one_lossless_place(node.bounds);
    const bool alone = interior_count(node.range) == 0;
    if (const auto axes = rule_.axes_of(node.range, node.coincident && alone ? Extents{} : extents_of(node)))
      node.axes = *axes;
    else
      open.push_back(n);
  }
  if (open.empty()) return;
  const std::vector<Point> extents = measure(open);
  for (std::size_t o = 0; o < open.size(); ++o) {
    Node& node = level_[open[o]];
    node.axes = *rule_.axes_of(node.range, {extents[o], extents[o]});
  }
}

std::vector<Point> TreeBuilder::measure(std::span<const std::size_t> nodes) {
  const std::size_t words = 2 * at(axes_);
  std::vector<std::uint64_t> least(nodes.size() * words, kNoOrderBits);
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    const Node& node = level_[nodes[n]];
    const QBounds& bounds = node.bounds;
    std::uint64_t* const own = &least[n * words];
    bool place_read = false;
    for (const Span& span : spans_of(node)) {
      result_.traffic.bytes += span.all().size() * sizeof(QuantisedPoint);
      for (const QuantisedPoint& point : span.all()) {
        if (node.place && point.q == *node.place && std::exchange(place_read, true)) continue;
        for (std::size_t a = 0; a < at(axes_); ++a) {
          if (point.q[a] != bounds.lo[a] && point.q[a] != bounds.hi[a]) continue;
          const std::uint64_t order_bits = geometry::order_bits(particles_.position[a][span.base + point.index]);
          own[2 * a] = std::min(own[2 * a], order_bits);
          own[2 * a + 1] = std::min(own[2 * a + 1], ~order_bits);
        }
      }
    }
  }
  result_.reductions += all_min_in_messages(comm_, least);
  std::vector<Point> extents(nodes.size());
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    const NodeRange& range = level_[nodes[n]].range;
    const geometry::Box interior = interior_box(range);
    bool coincident = !level_[nodes[n]].bounds.empty();
    for (std::size_t a = 0; a < at(axes_); ++a) {
      std::uint64_t lo = least[n * words + 2 * a];
      std::uint64_t hi = ~least[n * words + 2 * a + 1];
      coincident = coincident && lo == hi;
      if (!interior.empty(axes_)) {
        lo = std::min(lo, geometry::order_bits(interior.lo[a]));
        hi = std::max(hi, geometry::order_bits(interior.hi[a]));
      }
      extents[n][a] = geometry::extent(geometry::value_of_order_bits(lo), geometry::value_of_order_bits(hi));
    }
    level_[nodes[n]].coincident = coincident;
  }
  return extents;
}

CutRequest TreeBuilder::request_of(const Node& node) {
  CutRequest wanted{node};
  wanted.spans = spans_of(node);
  wanted.keep_ids = node.coincident && interior_ == nullptr && options_.cut_tolerance == 0;
  const auto [index, first, last] = node.range;
  wanted.left_size = rule_.size(first, node.range.middle());
  wanted.size = rule_.size(first, last);
  if (options_.cut_tolerance > 0) {
    wanted.rank = floor_share(node.count, wanted.left_size, wanted.size);
    wanted.slack = slack_of(node);
  } else {
    wanted.rank = rule_.quota(first, node.range.middle());
  }
  if (interior_ != nullptr) add_interior(node.range, wanted);
  if (bucketed()) wanted.expected = expected_in(node);
  wanted.search = !wanted.unanswerable && !node.bounds.empty() && (scale_ || wanted.rank < wanted.below + wanted.count);
  return wanted;
}

void TreeBuilder::expect_other_axes() {
  std::vector<std::size_t> others;
  for (std::size_t n = 0; n < level_.size(); ++n) {
    const Node& node = level_[n];
    if (node.number >= Splitters::kNodes || node.coincident || node.bounds.empty()) continue;
    const int axis = splitters_->expected[node.number].axis;
    if (axis >= 0 && axis != node.axes[0]) others.push_back(n);
  }
  if (others.empty()) return;
  std::vector<ExpectedCut> own;
  for (std::size_t k = 0; k < others.size() && comm_.rank() == 0; ++k) {
    const Node& node = level_[others[k]];
    const double rank = static_cast<double>(rule_.quota(node.range.first, node.range.middle()));
    own.push_back(
        expect_cut(start_.sample, node.sampled, node.axes[0], rank / static_cast<double>(node.count), options_.limits));
  }
  const Buffer<ExpectedCut> found = comm::values_of_first<ExpectedCut>(comm_, own);
  ++result_.reductions;
  for (std::size_t k = 0; k < others.size(); ++k) splitters_->expected[level_[others[k]].number] = found[k];
}

std::optional<std::array<std::int32_t, 2>> TreeBuilder::expected_in(const Node& node) const {
  if (node.number >= Splitters::kNodes || node.coincident || node.bounds.empty()) return std::nullopt;
  const ExpectedCut& expected = splitters_->expected[node.number];
  if (expected.axis != node.axes[0] || expected.anywhere()) return std::nullopt;
  const auto axis = at(expected.axis);
  const auto integer = [&](double x) { return maps_[axis](std::clamp(x, box_.lo[axis], box_.hi[axis])); };
  const std::int32_t lo = std::max(integer(expected.least), node.bounds.lo[axis]);
  const std::int32_t hi = std::min(integer(expected.most), node.bounds.hi[axis]);
  if (lo > hi) return std::nullopt;
  return std::array{lo, hi};
}

void TreeBuilder::add_interior(const NodeRange& range, CutRequest& wanted) const {
  wanted.below = interior_count(range.left());
  const std::uint64_t beyond = interior_count(range.right());
  // If the cut axis flipped, hardly any interior particle stays: not worth a search.
  if (wanted.axes[0] != result_.tree.cuts[at(range.node)].axes[0] && wanted.below + beyond > 0) {
    wanted.unanswerable = true;
    return;
  }
  if (!scale_) {
    const std::uint64_t most = wanted.below + wanted.count;
    wanted.unanswerable = wanted.rank < wanted.below || wanted.rank > most || (wanted.rank == most && beyond > 0);
    return;
  }
  const u128 own = wanted.weight;
  wanted.weight_below = interior_->weight(range.first, range.middle());
  wanted.weight += interior_->weight(range.first, range.last);
  if (wanted.bounds.empty()) {
    wanted.unanswerable = wanted.below + beyond > 0;
    return;
  }
  const u128 threshold = threshold_of(wanted);
  wanted.unanswerable =
      threshold == 0 ? wanted.below > 0 : threshold <= wanted.weight_below || threshold > wanted.weight_below + own;
}

bool TreeBuilder::cut_still_valid(const NodeRange& range, const CutRequest& wanted, const CutFound& found) const {
  if (wanted.unanswerable || found.failed) return false;
  const geometry::Box left = interior_box(range.left());
  const geometry::Box right = interior_box(range.right());
  if (left.empty(axes_) && right.empty(axes_)) return true;
  const auto axis = at(wanted.axes[0]);
  const bool any_left = !left.empty(axes_);
  if (found.right_empty && !right.empty(axes_)) return false;
  if (wanted.search && any_left && geometry::order_bits(left.hi[axis]) >= found.lowest_relied_on[0]) return false;
  return found.right_empty || right.empty(axes_) || found.highest_relied_on[0] < geometry::order_bits(right.lo[axis]);
}

void TreeBuilder::leave_uncut(std::size_t node) {
  const NodeRange& range = level_[node].range;
  uncut_.push_back(range);
  failed_count_ += (scale_ ? 0 : level_[node].count) + interior_count(range);
  for (const Span& span : spans_of(level_[node])) writer_.note(span, span.all(), range.first);
}

// By how much load a cut may miss its target. The tolerance is a fraction of each side's target; the smaller one
// decides.
u128 TreeBuilder::slack_of(const Node& node) const {
  const u128 left = rule_.size(node.range.first, node.range.middle());
  const u128 right = rule_.size(node.range.middle(), node.range.last);
  const double share = quotient(std::min(left, right), left + right);
  const double load = scale_ ? static_cast<double>(node.weight) : static_cast<double>(node.count);
  return static_cast<u128>(std::min(level_tolerance_, 1.0) * share * load);
}

void TreeBuilder::split(std::span<const CutRequest> wanted, std::span<const CutFound> found) {
  next_.clear();
  next_spans_.clear();
  for (std::size_t n = 0; n < level_.size(); ++n) {
    const Node& node = level_[n];
    const CutFound& own = found[n];
    if (interior_ != nullptr && !cut_still_valid(node.range, wanted[n], own)) {
      leave_uncut(n);
      continue;
    }
    Cut& cut = result_.tree.cuts[at(node.range.node)];
    cut = {};
    cut.axes = wanted[n].axes;
    cut.right_empty = own.right_empty;
    if (!cut.right_empty) {
      for (std::size_t w = 0; w < at(axes_); ++w) cut.key.at[w] = geometry::value_of_order_bits(own.key[w]);
      cut.key.id = static_cast<Id>(own.key[at(axes_)]);
    }
    Node left = node;
    Node right = node;
    left.range = node.range.left();
    right.range = node.range.right();
    if (!scale_) left.count = own.right_empty ? node.count : own.left_count - wanted[n].below;
    if (scale_) left.weight = own.right_empty ? node.weight : own.left_weight - wanted[n].weight_below;
    right.count = node.count - left.count;
    right.weight = node.weight - left.weight;
    left.bounds = right.bounds = QBounds{};
    left.number = 2 * node.number + 1;
    right.number = left.number + 1;
    if (node.sampled.size() > 0 && right.number < Splitters::kNodes && !cut.right_empty) {
      const auto axis = at(cut.axes[0]);
      const SortedSample::Halves halves =
          start_.sample.split(node.sampled, axis, start_.sample.below(node.sampled, axis, cut.key.at[0]));
      left.sampled = halves.left;
      right.sampled = halves.right;
    }
    left.ids_kept = right.ids_kept = own.ids_kept;
    if (own.place) left.place = right.place = own.place;
    if (node.coincident && !cut.right_empty) {
      left.id_last = cut.key.id - 1;
      right.id_first = cut.key.id;
    }
    take_child(left, false, n);
    take_child(right, true, n);
  }
  reduce_bounds(next_);
  settle_empty();
}

void TreeBuilder::settle_empty() {
  std::size_t kept = 0;
  for (std::size_t n = 0; n < next_.size(); ++n) {
    const NodeRange& range = next_[n].range;
    if (next_[n].bounds.empty() && interior_count(range) == 0) {
      cut_empty(range);
      continue;
    }
    next_[kept++] = next_[n];
  }
  next_.resize(kept);
}

void TreeBuilder::cut_empty(const NodeRange& range) {
  if (range.leaf()) return;
  Cut& cut = result_.tree.cuts[at(range.node)];
  cut = {};
  cut.axes = *rule_.axes_of(range, {});
  cut.right_empty = true;
  cut_empty(range.left());
  cut_empty(range.right());
}

void TreeBuilder::take_child(Node child, bool right, std::size_t parent) {
  const bool leaf = child.range.leaf();
  if (leaf && !scale_) result_.counts[at(child.range.first)] = child.count + interior_count(child.range);
  child.spans_first = next_spans_.size();
  for (const Span& span : spans_of(level_[parent])) {
    QuantisedPoint* const first = right ? span.middle : span.first;
    QuantisedPoint* const last = right ? span.last : span.middle;
    if (first == last) continue;
    if (leaf) {
      writer_.note(span, {first, last}, child.range.first);
      continue;
    }
    Span& own = next_spans_.emplace_back(span);
    own.first = first;
    own.last = last;
    if (own.size() < span.size()) own.bucket = Span::kNoBucket;
    if (child.coincident) {
      own.bounds = level_[parent].bounds;
    } else if (own.size() < span.size() || own.bounds.empty()) {
      own.bounds = {};
      widen(own.bounds, own.all());
      result_.traffic.bytes += own.size() * sizeof(QuantisedPoint);
    }
    child.bounds.extend(own.bounds);
  }
  child.spans_last = next_spans_.size();
  if (!leaf) next_.push_back(child);
}

void TreeBuilder::reduce_bounds(std::span<Node> nodes) {
  std::vector<std::uint64_t> least;
  least.reserve(nodes.size() * at(axes_) * 2);
  for (const Node& node : nodes)
    for (std::size_t a = 0; a < at(axes_); ++a) {
      least.push_back(static_cast<std::uint64_t>(node.bounds.lo[a]));
      least.push_back(static_cast<std::uint64_t>(std::int64_t{QBounds::kNone} - node.bounds.hi[a]));
    }
  result_.reductions += all_min_in_messages(comm_, least);
  std::size_t word = 0;
  for (Node& node : nodes)
    for (std::size_t a = 0; a < at(axes_); ++a) {
      node.bounds.lo[a] = static_cast<std::int32_t>(least[word++]);
      node.bounds.hi[a] = static_cast<std::int32_t>(QBounds::kNone - static_cast<std::int64_t>(least[word++]));
    }
}

}  // namespace rcb::partition
