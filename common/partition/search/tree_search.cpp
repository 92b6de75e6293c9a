#include "common/partition/search/tree_search.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <utility>

#include "common/base/check.hpp"
#include "common/base/index.hpp"
#include "common/partition/balance/bounds.hpp"
#include "common/partition/search/cut_search.hpp"
#include "common/partition/search/node_axes.hpp"

namespace rcb::partition {

CutTree uncut_tree(const PartitionOptions& options, int dims) {
  CutTree tree;
  tree.dims = dims;
  tree.method = options.method;
  tree.parts = options.parts;
  tree.part_sizes = options.part_sizes;
  tree.cuts.resize(at(options.parts) - 1);
  return tree;
}

TreeSearch::TreeSearch(comm::Comm& comm, const particles::ParticleView& particles, const PartitionOptions& options,
                       const SearchStart& start, SearchCost& cost)
    : comm_(comm),
      particles_(particles),
      options_(options),
      start_(start),
      cost_(cost),
      rule_(options, particles.dims),
      search_({comm, particles, start.maps, start.scale, options.tuning, cost}) {
  result_.tree = uncut_tree(options, particles.dims);
  result_.part_of_bucket.assign(start_.buckets.size(), -1);
  if (!start_.scale) result_.counts.resize(at(options.parts));
  // (1 + level tolerance)^levels <= 1 + tolerance
  const double levels = std::bit_width(static_cast<unsigned>(options.parts - 1));
  level_tolerance_ = std::expm1(std::log1p(options.cut_tolerance) / std::max(levels, 1.0));
}

std::optional<TreeFound> TreeSearch::find(const comm::GoOn& go_on) {
  Node root{.range = result_.tree.root()};
  for (std::size_t b = 0; b < start_.buckets.size(); ++b)
    if (!start_.buckets[b].empty()) root.wholes.push_back(static_cast<std::int32_t>(b));
  root.load = load_of(start_.buckets, root.wholes);
  rule_.set_all(root.load.count, box_of(start_.buckets, root.wholes).extents(particles_.dims));
  if (root.empty())
    cut_empty(root.range);
  else
    level_.push_back(std::move(root));
  NodeAxes axes(comm_, particles_, start_.maps, start_.buckets, rule_, cost_);
  while (!level_.empty()) {
    if (go_on && !go_on()) return std::nullopt;
    axes.order(level_);
    if (!search_level()) return std::nullopt;
    cut_level();
  }
  return std::move(result_);
}

// The prefix of keys that reaches this load ends with the wanted key.
u128 TreeSearch::load_wanted(const CutRequest& wanted) const {
  return start_.scale ? threshold_of(wanted) : u128{wanted.rank} + 1;
}

// By how much load a cut may miss its target. The tolerance is a fraction of each side's target; the smaller one
// decides.
u128 TreeSearch::slack_of(const Node& node) const {
  const u128 left = rule_.size(node.range.first, node.range.middle());
  const u128 right = rule_.size(node.range.middle(), node.range.last);
  const double share = quotient(std::min(left, right), left + right);
  return static_cast<u128>(std::min(level_tolerance_, 1.0) * share * static_cast<double>(amount(node.load)));
}

CutRequest TreeSearch::request_of(const Node& node) const {
  CutRequest wanted{.axes = node.axes, .all = node.load};
  wanted.left_size = rule_.size(node.range.first, node.range.middle());
  wanted.size = rule_.size(node.range.first, node.range.last);
  if (options_.cut_tolerance > 0) {
    wanted.rank = floor_share(node.load.count, wanted.left_size, wanted.size);
    wanted.slack = slack_of(node);
  } else {
    wanted.rank = rule_.quota(node.range.first, node.range.middle());
  }
  return wanted;
}

std::vector<TreeSearch::Pending> TreeSearch::begin_level() {
  std::vector<Pending> pending;
  wanted_.clear();
  for (std::size_t n = 0; n < level_.size(); ++n) {
    const Node& node = level_[n];
    CutRequest& wanted = wanted_.emplace_back(request_of(node));
    if (!start_.scale && wanted.rank == node.load.count) continue;  // nothing goes right
    const Wholes wholes = wholes_of(node);
    wanted.within = wholes.gap();
    if (wanted.within.empty()) wanted.within = wholes.likely(load_wanted(wanted));
    pending.push_back({n, wanted.within});
  }
  return pending;
}

bool TreeSearch::open(std::span<const Pending> pending) {
  std::vector<std::int32_t> unmade;
  for (const auto& [n, interval] : pending)
    for (const std::int32_t b : level_[n].wholes) {
      if (!interval.meets(wholes_of(level_[n]).interval_of(b)) || std::exchange(start_.buckets[at(b)].has_points, true))
        continue;
      unmade.push_back(b);
      result_.opened += start_.buckets[at(b)].load.count;
    }
  if (result_.opened > start_.opened_max) return false;
  if (!unmade.empty()) reduce_lossless(comm_, start_.make_points(unmade), start_.maps, particles_.dims, cost_);
  for (const auto& [n, interval] : pending) {
    Node& node = level_[n];
    const auto opened = std::ranges::stable_partition(
        node.wholes, [&, wholes = wholes_of(node)](std::int32_t b) { return !interval.meets(wholes.interval_of(b)); });
    for (const std::int32_t b : opened) {
      for (Segment& segment : start_.points.take(at(b))) {
        kernels().widen(segment.bounds, segment.all());
        cost_.bytes += segment.size() * sizeof(QuantisedPoint);
        node.segments.push_back(segment);
      }
      node.points.bounds.extend(start_.buckets[at(b)].q);
    }
    node.wholes.erase(opened.begin(), opened.end());
    node.points.load = node.load - load_of(start_.buckets, node.wholes);
  }
  return true;
}

bool TreeSearch::search_level() {
  found_.assign(level_.size(), {});
  for (CutFound& found : found_) found.right_empty = true;
  std::vector<Pending> pending = begin_level();
  for (std::size_t tries = 0; !pending.empty(); ++tries) {
    RCB_CHECK(tries <= 2 + start_.buckets.size(), "each try opens a whole, but for the first and the last one");
    if (!open(pending)) return false;
    std::vector<CutRequest> asked;
    for (const auto& [n, interval] : pending) {
      Node& node = level_[n];
      CutRequest& own = wanted_[n];
      own.points = node.points;
      own.points.segments = node.segments;
      own.points.one_place = node.points.one_place && node.wholes.empty();
      own.before = wholes_of(node).load_in({0, own.within.lo - 1});
      asked.push_back(own);
    }
    const std::vector<CutFound> found = search_.find(asked);
    pending = check(pending, found);
  }
  return true;
}

std::vector<TreeSearch::Pending> TreeSearch::check(std::span<const Pending> pending, std::span<const CutFound> found) {
  std::vector<Pending> again;
  for (std::size_t k = 0; k < pending.size(); ++k) {
    const std::size_t n = pending[k].node;
    const Wholes wholes = wholes_of(level_[n]);
    CutRequest& wanted = wanted_[n];
    const CutFound& own = found_[n] = found[k];
    Interval to_open = own.relied_on;
    if (own.where == CutFound::Where::below) {
      to_open = wanted.within =
          wholes.certain({0, wanted.within.lo - 1}, amount(own.points_below), load_wanted(wanted));
    } else if (own.where == CutFound::Where::above) {
      const u128 before = amount(wanted.before + own.points_below + own.points_within);
      const u128 loose = amount(wanted.points.load - own.points_below - own.points_within);
      to_open = wanted.within =
          wholes.certain({wanted.within.hi + 1, AxisMap::kTop}, loose, load_wanted(wanted) - before);
    } else if (to_open.hi == AxisMap::kTop) {  // the next key above isn't a point's: the nearest whole has one
      to_open.hi = wholes.first_above(wanted.within.hi);
    }
    if (own.where != CutFound::Where::within || wholes.meets(to_open)) again.push_back({n, to_open});
  }
  return again;
}

void TreeSearch::cut_level() {
  std::vector<Node> next;
  for (std::size_t n = 0; n < level_.size(); ++n) {
    const Node& node = level_[n];
    const CutFound& found = found_[n];
    Cut& cut = result_.tree.cuts[at(node.range.node)];
    cut = {.axes = node.axes, .right_empty = found.right_empty};
    if (!cut.right_empty) {
      for (std::size_t w = 0; w < at(particles_.dims); ++w) cut.key.at[w] = geometry::value_of_order_bits(found.key[w]);
      cut.key.id = static_cast<Id>(found.key[at(particles_.dims)]);
    }
    for (const bool right : {false, true}) {
      Node own = child(node, found, right);
      if (own.range.leaf())
        finish_part(own);
      else
        next.push_back(std::move(own));
    }
  }
  reduce_bounds(next);
  level_.clear();
  for (Node& node : next) {
    if (node.empty())
      cut_empty(node.range);
    else
      level_.push_back(std::move(node));
  }
}

Node TreeSearch::child(const Node& parent, const CutFound& found, bool right) {
  Node own{.range = right ? parent.range.right() : parent.range.left()};
  const Load left = found.right_empty ? parent.load : found.left;
  own.load = right ? parent.load - left : left;
  const std::int32_t key =
      found.right_empty ? AxisMap::kTop : start_.maps[at(parent.axes[0])](geometry::value_of_order_bits(found.key[0]));
  for (const std::int32_t b : parent.wholes) {
    const Interval span = wholes_of(parent).interval_of(b);
    const bool goes_right = !found.right_empty && span.lo > key;
    RCB_CHECK(found.right_empty || goes_right || span.hi < key, "a cut leaves wholes whole");
    if (goes_right == right) own.wholes.push_back(b);
  }
  own.points.load = own.load - load_of(start_.buckets, own.wholes);
  own.points.one_place = parent.points.one_place && parent.wholes.empty();
  own.points.by_id = parent.points.by_id || found.by_id;
  own.points.crowd = found.crowd ? found.crowd : parent.points.crowd;
  for (const Segment& segment : parent.segments) {
    QuantisedPoint* const middle = found.right_empty ? segment.last : segment.middle;
    Segment part = segment;
    (right ? part.first : part.last) = middle;
    if (part.size() == 0) continue;
    if (own.range.leaf()) {
      own.segments.push_back(part);
      continue;
    }
    if (part.size() < segment.size() || found.by_id) {
      part.bounds = {};
      kernels().widen(part.bounds, part.all());
      cost_.bytes += part.size() * sizeof(QuantisedPoint);
    }
    own.points.bounds.extend(part.bounds);
    own.segments.push_back(part);
  }
  return own;
}

void TreeSearch::finish_part(const Node& leaf) {
  const std::int32_t part = leaf.range.first;
  if (!start_.scale) result_.counts[at(part)] = leaf.load.count;
  for (const Segment& segment : leaf.segments) result_.points.push_back({segment.all(), segment.base, part});
  for (const std::int32_t b : leaf.wholes) result_.part_of_bucket[at(b)] = part;
}

// Without particles the cuts of a node, and those below, follow from the rule alone. With many more parts than
// particles most nodes are such.
void TreeSearch::cut_empty(const NodeRange& range) {
  if (range.leaf()) return;
  result_.tree.cuts[at(range.node)] = {.axes = *rule_.axes_of(range, {}), .right_empty = true};
  cut_empty(range.left());
  cut_empty(range.right());
}

// Turns this rank's bounds of these nodes' points into those of all ranks.
void TreeSearch::reduce_bounds(std::span<Node> nodes) {
  AllMinMax all;
  for (const Node& node : nodes)
    for (std::size_t a = 0; a < at(particles_.dims); ++a)  // the greatest of no points is -1
      all.add(static_cast<std::uint64_t>(node.points.bounds.lo[a]), at(node.points.bounds.hi[a] + 1));
  cost_.reductions += all.reduce(comm_);
  for (Node& node : nodes)
    for (std::size_t a = 0; a < at(particles_.dims); ++a) {
      std::uint64_t least = 0;
      std::uint64_t most = 0;
      all.take(least, most);
      node.points.bounds.lo[a] = static_cast<std::int32_t>(least);
      node.points.bounds.hi[a] = static_cast<std::int32_t>(most) - 1;
    }
}

}  // namespace rcb::partition
