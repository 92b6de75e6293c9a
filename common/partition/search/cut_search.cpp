#include "common/partition/search/cut_search.hpp"

#include <utility>

#include <boost/multiprecision/cpp_int.hpp>

#include "common/base/check.hpp"
#include "common/partition/points/segment.hpp"
#include "common/partition/search/node_state.hpp"

namespace rcb::partition {
namespace {

using Product = boost::multiprecision::uint512_t;

void divide_by_key(NodeState& node) {
  restore_integers(node);
  for (Segment& segment : node.segments()) {
    segment.middle = segment.upper =
        node.found.right_empty ? segment.last
                               : std::partition(segment.middle, segment.upper, [&](const QuantisedPoint& point) {
                                   return node.key(segment.base + point.index) < node.found.key;
                                 });
  }
}

// Where one integer is left it is replaced by a key word, unless it is cheaper to gather the points.
void choose_next_phase(NodeState& node) {
  const bool one_left = node.bracket.lo == node.bracket.hi;
  if (node.inside <= node.context.gather_limit * (one_left ? Tuning::kExhaustedFactor : 1)) {
    node.phase = Phase::gather;
  } else if (one_left) {
    node.phase = Phase::next_word;
    const bool word_is_known =
        node.word.replaced ? node.word.shift <= node.zeros_of(node.word.index) : node.lossless(0);
    if (!word_is_known) return;
    ++node.word.index;
    node.word.shift = 0;
  }
}

// With slack: cuts between two bins, if that is near enough to the target.
bool take_near(NodeState& node, const Crossing& crossing) {
  const CutRequest& request = node.request;
  const SearchContext& context = node.context;
  if (request.slack == 0 || node.word.replaced) return false;
  const auto load = [&](const Load& own) { return context.weighted() ? own.weight : u128{own.count}; };
  const u128 target = context.weighted() ? node.threshold : u128{request.rank};
  const auto off = [&](const Load& left) { return load(left) < target ? target - load(left) : load(left) - target; };
  const std::size_t axis = node.axis_of(0);
  const Load behind = crossing.below + crossing.inside;
  const bool take = off(behind) < off(crossing.below);
  const Load left = take ? behind : crossing.below;
  // Behind the last bin the integer may not fit in 32 bits.
  const std::uint64_t beyond = at(node.bracket.lo) + ((*crossing.bin + (take ? 1 : 0)) << crossing.shift);
  if (off(left) > request.slack || beyond > at(request.points.bounds.hi[axis])) return false;
  const auto q = static_cast<std::int32_t>(beyond);
  const cuts::Key key = key_between(context.maps[axis].first_value(q), context.particles.dims);
  for (std::size_t w = 0; w < context.axes(); ++w) node.found.key[w] = geometry::order_bits(key.at[w]);
  node.found.left = left;
  node.found.relied_on = {q, q};
  node.note_pass(2 * sizeof(QuantisedPoint));
  for (Segment& segment : node.segments()) segment.middle = segment.upper = divide(segment.undecided(), axis, q);
  node.phase = Phase::done;
  return true;
}

// Leaves undecided what lies in the bracket. Where the range of a segment's integers tells that it lies on one side
// nothing is read.
void narrow_to_bracket(NodeState& node) {
  const std::size_t axis = node.searched_axis();
  const Interval bracket = node.bracket;
  for (Segment& segment : node.segments()) {
    const std::int32_t lo = node.word.replaced ? 0 : segment.bounds.lo[axis];
    const std::int32_t hi = node.word.replaced ? AxisMap::kTop : segment.bounds.hi[axis];
    const auto divided = [&](std::int32_t first_right) {
      node.context.cost.bytes += 2 * segment.undecided().size_bytes();
      return divide(segment.undecided(), axis, first_right);
    };
    if (lo < bracket.lo) segment.middle = hi < bracket.lo ? segment.upper : divided(bracket.lo);
    if (hi > bracket.hi) segment.upper = lo > bracket.hi ? segment.middle : divided(bracket.hi + 1);
  }
}

// The bin that holds the wanted key becomes the bracket.
void take(NodeState& node, const Crossing& crossing) {
  if (node.counts_outside && !node.is_within(crossing.points_below, crossing.points_within)) return;
  RCB_CHECK(crossing.bin, "a bin holds the wanted key");
  node.below = crossing.below;
  if (take_near(node, crossing)) return;
  node.inside = crossing.inside.count;
  node.bracket.lo += static_cast<std::int32_t>(*crossing.bin << crossing.shift);
  // From the least to the greatest integer of a bin, which are multiples of 2^zeros.
  const auto step = static_cast<std::int32_t>((1U << crossing.shift) - (1U << node.zeros()));
  if (node.bracket.hi - node.bracket.lo > step) node.bracket.hi = node.bracket.lo + step;
  narrow_to_bracket(node);
  choose_next_phase(node);
}

void start(NodeState& node) {
  const bool weighted = node.context.weighted();
  const auto& [segments, load, bounds, one_place, by_id, crowd] = node.request.points;
  node.found.by_id = by_id;
  for (Segment& segment : segments) {
    segment.middle = segment.first;
    segment.upper = segment.last;
  }
  if (weighted) node.threshold = threshold_of(node.request);
  if (weighted && node.threshold == 0) {  // no weight at all: the left side takes nothing
    node.phase = Phase::neighbour;
    return;
  }
  const Interval within = node.request.within;
  const Interval all{bounds.lo[node.searched_axis()], bounds.hi[node.searched_axis()]};
  node.bracket = {std::max(within.lo, all.lo), std::min(within.hi, all.hi)};
  if (all.lo >= within.lo && all.hi <= within.hi) {  // all points are within
    if (!node.is_within({}, load)) return;
  } else if (node.bracket.empty()) {  // none is
    node.is_within(all.hi < within.lo ? load : Load{}, {});
    return;
  } else {  // some may be: they are counted together with the others
    node.counts_outside = true;
    node.below = node.request.before;
    node.inside = load.count;
    // On a lossless axis bins begin at multiples of the step, as integers do. Without one in it the bracket has no
    // point.
    const std::int64_t step = std::int64_t{1} << node.zeros();
    const std::int64_t first = (node.bracket.lo + step - 1) / step * step;
    if (first <= node.bracket.hi) node.bracket.lo = static_cast<std::int32_t>(first);
  }
  node.word.replaced = by_id;
  if (one_place) node.word.index = node.context.axes();
  node.phase = one_place && !by_id ? Phase::next_word : Phase::count;
  if (!weighted && node.inside <= node.context.gather_limit)
    node.phase = Phase::gather;
  else if (node.counts_outside)
    narrow_to_bracket(node);
}

// Each candidate costs every rank about 0.2 us, and a round more of counting one collective. With slack the limit is
// the same everywhere, since the cuts depend on it.
std::uint64_t gather_limit_of(const SearchContext& context, std::span<const CutRequest> requests) {
  const bool exact = std::ranges::all_of(requests, [](const CutRequest& own) { return own.slack == 0; });
  const std::uint64_t factor = context.comm.over_network() && exact ? Tuning::kNetworkFactor : 1;
  return factor * std::min(std::max(Tuning::kGatheredTogether / requests.size(), Tuning::kGatherAlways),
                           context.tuning.gather_max);
}

}  // namespace

u128 threshold_of(const CutRequest& request) {
  const Product load = Product(request.all.weight) * request.left_size;
  return static_cast<u128>(Product((load + request.size - 1) / request.size));
}

std::vector<CutFound> CutSearch::find(std::span<const CutRequest> requests) {
  if (requests.empty()) return {};
  context_.gather_limit = gather_limit_of(context_, requests);
  std::vector<NodeState> nodes;
  for (const CutRequest& own : requests) nodes.push_back({context_, own});
  for (NodeState& node : nodes) start(node);
  const auto in_phase = [&](Phase phase) {
    std::vector<NodeState*> found;
    for (NodeState& node : nodes)
      if (node.phase == phase) found.push_back(&node);
    return found;
  };
  do {
    const std::vector<NodeState*> counted = in_phase(Phase::count);
    const std::vector<Crossing> crossings = count_round(context_, counted);
    for (std::size_t n = 0; n < counted.size(); ++n) take(*counted[n], crossings[n]);
    next_words(context_, in_phase(Phase::next_word));
  } while (!in_phase(Phase::count).empty());
  choose_among_candidates(context_, in_phase(Phase::gather));
  find_neighbours(context_, in_phase(Phase::neighbour));
  std::vector<CutFound> found;
  for (NodeState& node : nodes) {
    if (node.found.where == CutFound::Where::within) divide_by_key(node);
    found.push_back(node.found);
  }
  return found;
}

}  // namespace rcb::partition
