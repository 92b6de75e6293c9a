#include <boost/multiprecision/cpp_int.hpp>

#include "common/base/check.hpp"
#include "common/comm/gather.hpp"
#include "common/partition/search/node_state.hpp"

namespace rcb::partition {
namespace {

struct Candidate {
  std::uint64_t node;  // its place among those gathered
  KeyWords key;
  std::array<std::uint64_t, 2> weight_words;

  u128 weight() const { return u128{weight_words[0]} | (u128{weight_words[1]} << 64U); }
};

// In the order of nodes and keys. Collective (one gather).
Buffer<Candidate> gather(SearchContext& context, NodeStates nodes) {
  std::vector<Candidate> mine;
  for (std::size_t n = 0; n < nodes.size(); ++n)
    for (const Segment& segment : nodes[n]->segments())
      for (const QuantisedPoint& point : segment.undecided()) {
        const std::size_t particle = segment.base + point.index;
        const u128 weight = context.weight(particle);
        mine.push_back({n,
                        nodes[n]->key(particle),
                        {static_cast<std::uint64_t>(weight), static_cast<std::uint64_t>(weight >> 64U)}});
      }
  Buffer<Candidate> all = comm::all_gather_few_values<Candidate>(context.comm, mine);
  ++context.cost.reductions;
  std::sort(all.begin(), all.end(),
            [](const Candidate& a, const Candidate& b) { return a.node != b.node ? a.node < b.node : a.key < b.key; });
  return all;
}

void choose(NodeState& node, std::span<const Candidate> candidates) {
  const std::uint64_t place = node.request.rank - node.below.count;
  node.found.left.count = node.request.rank;
  node.found.key = candidates[place].key;
  node.found.relied_on.lo = node.found.relied_on.hi = node.integer(node.found.key);
}

// The left side takes the prefix with the weight nearest to the wanted one; on a tie, and among prefixes of the same
// weight, the shortest.
void choose_by_weight(NodeState& node, std::span<const Candidate> candidates) {
  using Product = boost::multiprecision::uint512_t;
  CutFound& found = node.found;
  u128 before = node.below.weight;
  std::size_t crossing = 0;
  while (crossing < candidates.size() && before + candidates[crossing].weight() < node.threshold)
    before += candidates[crossing++].weight();
  RCB_CHECK(crossing < candidates.size(), "the wanted weight is reached inside the bracket");
  const u128 after = before + candidates[crossing].weight();
  found.relied_on.lo = found.relied_on.hi = node.integer(candidates[crossing].key);
  const Product target = Product(node.request.all.weight) * node.request.left_size;
  if (Product(after) * node.request.size - target < target - Product(before) * node.request.size) {
    found.left.weight = after;
    if (crossing + 1 < candidates.size()) {
      found.key = candidates[crossing + 1].key;
      found.relied_on.hi = node.integer(found.key);
      return;
    }
    node.neighbour.bound = candidates[crossing].key;
  } else {
    found.left.weight = before;
    while (crossing > 0 && candidates[crossing - 1].weight() == 0) --crossing;
    if (crossing > 0 || node.below.count == 0) {
      found.key = candidates[crossing].key;
      found.relied_on.lo = node.integer(candidates[crossing > 0 ? crossing - 1 : 0].key);
      return;
    }
    if (node.below.weight > 0) node.neighbour = {candidates[0].key, true};
  }
  node.phase = Phase::neighbour;
}

// If the candidates are all of the node's points, they tell whether the key is within.
bool keep_those_within(NodeState& node, std::span<const Candidate>& candidates) {
  if (!node.counts_outside) return true;
  const auto first_from = [&](std::int64_t q) {
    return std::ranges::lower_bound(candidates, q, {}, [&](const Candidate& own) { return node.integer(own.key); });
  };
  const auto first = first_from(node.request.within.lo);
  const auto last = first_from(std::int64_t{node.request.within.hi} + 1);
  const Load points_below{static_cast<std::uint64_t>(first - candidates.begin()), 0};
  candidates = {first, last};
  return node.is_within(points_below, {candidates.size(), 0});
}

void choose_in_group(SearchContext& context, NodeStates nodes) {
  const Buffer<Candidate> all = gather(context, nodes);
  const Candidate* first = all.begin();
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    const Candidate* const last = std::find_if(first, all.end(), [n](const Candidate& own) { return own.node != n; });
    std::span<const Candidate> candidates(first, last);
    first = last;
    NodeState& node = *nodes[n];
    RCB_CHECK(candidates.size() == node.inside, "the candidates are those counted");
    node.phase = Phase::done;
    if (keep_those_within(node, candidates)) (context.weighted() ? choose_by_weight : choose)(node, candidates);
  }
}

// The key nearest to each bound: after it or, if backward, before it and with weight > 0. Where there is none, the
// greatest key that there can be; if backward, the least. Collective.
std::vector<KeyWords> nearest(SearchContext& context, NodeStates nodes, bool backward) {
  std::vector<KeyWords> keys(nodes.size(), backward ? kLeastKey : kGreatestKey);
  const auto offer = [&](std::size_t n, const KeyWords& key) {
    keys[n] = backward ? std::max(keys[n], key) : std::min(keys[n], key);
  };
  for (std::size_t n = 0; n < nodes.size(); ++n)
    for (const Segment& segment : nodes[n]->segments())
      for (const QuantisedPoint& point : segment.all()) {
        const std::size_t particle = segment.base + point.index;
        const KeyWords key = nodes[n]->key(particle);
        const KeyWords& bound = nodes[n]->neighbour.bound;
        if (backward ? key < bound && context.weight(particle) > 0 : bound < key) offer(n, key);
      }
  const std::size_t group = comm::kMessageBytesMax / sizeof(KeyWords) / at(context.comm.size()) + 1;
  for (std::size_t first = 0; first < nodes.size(); first += group) {
    const std::size_t count = std::min(group, nodes.size() - first);
    const auto all = comm::all_gather_few_values<KeyWords>(context.comm, std::span(keys).subspan(first, count));
    for (std::size_t k = 0; k < all.size(); ++k) offer(first + k % count, all[k]);
    ++context.cost.reductions;
  }
  return keys;
}

}  // namespace

void choose_among_candidates(SearchContext& context, NodeStates nodes) {
  constexpr std::size_t limit = 2 * comm::kMessageBytesMax / sizeof(Candidate);
  while (!nodes.empty()) {
    std::size_t group = 0;
    std::uint64_t total = 0;
    do total += nodes[group++]->inside;
    while (group < nodes.size() && total + nodes[group]->inside <= limit);
    choose_in_group(context, nodes.first(group));
    nodes = nodes.subspan(group);
  }
}

void find_neighbours(SearchContext& context, NodeStates nodes) {
  std::vector<NodeState*> backward;
  std::ranges::copy_if(nodes, std::back_inserter(backward), [](auto* node) { return node->neighbour.weighted_before; });
  const std::vector<KeyWords> before = nearest(context, backward, true);
  for (std::size_t n = 0; n < backward.size(); ++n) {
    backward[n]->neighbour.bound = before[n];
    if (before[n] != kLeastKey) backward[n]->found.relied_on.lo = backward[n]->integer(before[n]);
  }
  const std::vector<KeyWords> next = nearest(context, nodes, false);
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    CutFound& found = nodes[n]->found;
    found.key = next[n];
    found.right_empty = next[n] == kGreatestKey;
    found.relied_on.hi = found.right_empty ? AxisMap::kTop : std::max(found.relied_on.hi, nodes[n]->integer(next[n]));
    if (nodes[n]->neighbour.bound == kLeastKey) found.relied_on.lo = 0;  // a whole may hold the least key
    for (Segment& segment : nodes[n]->segments()) {
      segment.middle = segment.first;
      segment.upper = segment.last;
    }
  }
}

}  // namespace rcb::partition
