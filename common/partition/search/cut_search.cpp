#include "common/partition/search/cut_search.hpp"

#include <utility>

#include <boost/multiprecision/cpp_int.hpp>

#include "common/base/check.hpp"
#include "common/partition/points/divide.hpp"
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

// The last rounds divided by little: integers separate the points badly.
bool separates_little(const NodeState& node, std::uint64_t before) {
  return node.rounds > 1 && node.inside > before / 2;
}

// Counting integers, as they are, is of no use any more.
bool integers_exhausted(const NodeState& node, std::uint64_t before) {
  const bool one_left = node.bracket.lo == node.bracket.hi;
  return one_left || (!node.words.replaced && (separates_little(node, before) || node.rounds >= Tuning::kRoundsMax));
}

// The next key word stands in the integers of another axis already.
bool next_word_is_free(const NodeState& node) {
  return node.bracket.lo == node.bracket.hi && !node.words.replaced && node.lossless(0) && node.lossless(1);
}

// Integers that separate little more are replaced by a key word, unless it is cheaper to gather what is left.
void choose_next_phase(NodeState& node, std::uint64_t before) {
  ++node.rounds;
  const bool exhausted = integers_exhausted(node, before);
  const bool costly = exhausted && !next_word_is_free(node);
  if (node.inside <= node.context.gather_limit * (costly ? Tuning::kExhaustedFactor : 1))
    node.phase = Phase::gather;
  else if (exhausted)
    node.phase = Phase::next_word;
}

// With slack: cuts between two bins, if that is near enough to the target.
bool take_near(NodeState& node, const Crossing& crossing) {
  const CutRequest& wanted = node.wanted;
  const SearchContext& context = node.context;
  if (wanted.slack == 0 || node.words.replaced) return false;
  const auto load = [&](const Load& own) { return context.weighted() ? own.weight : u128{own.count}; };
  const u128 target = context.weighted()
                          ? static_cast<u128>(Product(Product(wanted.all.weight) * wanted.left_size / wanted.size))
                          : u128{wanted.rank};
  const auto off = [&](const Load& left) { return load(left) < target ? target - load(left) : load(left) - target; };
  const Load behind = crossing.below + crossing.inside;
  const bool take = off(behind) < off(crossing.below);
  const Load left = take ? behind : crossing.below;
  // Behind the last bin the integer may not fit in 32 bits.
  const std::uint64_t beyond = at(node.bracket.lo) + ((*crossing.bin + (take ? 1 : 0)) << crossing.shift);
  if (off(left) > wanted.slack || beyond > at(wanted.points.bounds.hi[node.axis()])) return false;
  const auto q = static_cast<std::int32_t>(beyond);
  const cuts::Key key = key_between(context.maps[node.axis()].first_value(q), context.particles.dims);
  for (std::size_t w = 0; w < context.axes(); ++w) node.found.key[w] = geometry::order_bits(key.at[w]);
  node.found.left = left;
  node.found.relied_on = {q, q};
  node.note_pass(2 * sizeof(QuantisedPoint));
  for (Segment& segment : node.segments()) segment.middle = segment.upper = divide(segment.undecided(), node.axis(), q);
  node.phase = Phase::done;
  return true;
}

// Leaves undecided what lies in the bracket. Where the range of a segment's integers tells that it lies on one side
// nothing is read.
//   few  whether few of the points are in the bracket, if that is known; else the range tells if few are on one side.
//        Then only these are moved.
void narrow_to_bracket(NodeState& node, std::optional<bool> few) {
  constexpr std::int64_t kFew = 8;
  const std::size_t axis = node.axis();
  const Interval bracket = node.bracket;
  for (Segment& segment : node.segments()) {
    // Key words that have replaced integers may be any of 31 bits, kTop + 1 too.
    const std::int64_t lo = node.words.replaced ? 0 : segment.bounds.lo[axis];
    const std::int64_t hi = node.words.replaced ? std::numeric_limits<std::int32_t>::max() : segment.bounds.hi[axis];
    const auto divided = [&](std::int32_t first_right, bool few_before) {
      const bool few_left = few ? few_before : (first_right - lo) * kFew < hi - first_right;
      const bool few_right = !few && (hi - first_right) * kFew < first_right - lo;
      node.context.cost.bytes += (few_left || few_right ? 1 : 2) * segment.undecided().size_bytes();
      return (few_left ? divide_few : few_right ? divide_few_right : divide)(segment.undecided(), axis, first_right);
    };
    if (lo < bracket.lo) segment.middle = hi < bracket.lo ? segment.upper : divided(bracket.lo, false);
    if (hi > bracket.hi)
      segment.upper = lo > bracket.hi ? segment.middle : divided(bracket.hi + 1, few.value_or(false));
  }
}

// The bin that holds the wanted key becomes the bracket.
void take(NodeState& node, const Crossing& crossing) {
  if (node.outside_unknown && !node.is_within(crossing.points_below, crossing.points_within)) return;
  RCB_CHECK(crossing.bin, "a bin holds the wanted key");
  node.below = crossing.below;
  if (take_near(node, crossing)) return;
  const std::uint64_t before = std::exchange(node.inside, crossing.inside.count);
  const std::int32_t top = node.bracket.hi;
  node.bracket.lo += static_cast<std::int32_t>(*crossing.bin << crossing.shift);
  // A bin of a lossless axis may hold one integer only.
  const bool one = !node.words.replaced && node.lossless(0) && crossing.shift == node.zeros_of(0);
  const auto step = one ? 0 : static_cast<std::int32_t>((std::uint64_t{1} << crossing.shift) - 1);
  if (top - node.bracket.lo > step) node.bracket.hi = node.bracket.lo + step;
  narrow_to_bracket(node, node.inside < before / 16);
  choose_next_phase(node, before);
}

void start(NodeState& node) {
  const bool weighted = node.context.weighted();
  const auto& [segments, load, bounds, one_place] = node.wanted.points;
  node.found.ids_kept = one_place.by_id;
  node.found.right_empty = !node.wanted.search;
  for (Segment& segment : segments) {
    segment.middle = segment.first;
    segment.upper = segment.last;
  }
  if (!node.wanted.search) return;
  if (weighted) node.threshold = threshold_of(node.wanted);
  if (weighted && node.threshold == 0) {  // no weight at all: the left side takes nothing
    node.phase = Phase::neighbour;
    return;
  }
  const Interval within = node.wanted.within;
  const Interval all{bounds.lo[node.axis_of(0)], bounds.hi[node.axis_of(0)]};
  node.bracket = {std::max(within.lo, all.lo), std::min(within.hi, all.hi)};
  if (all.lo >= within.lo && all.hi <= within.hi) {
    if (!node.is_within({}, load)) return;
  } else if (node.bracket.empty()) {
    node.is_within(all.hi < within.lo ? load : Load{}, {});
    return;
  } else {
    node.outside_unknown = true;
    node.below = node.wanted.before;
    node.inside = load.count;
    // On a lossless axis bins begin at multiples of the step, as integers do. Without one in it the bracket has no
    // point.
    const std::int64_t step = std::int64_t{1} << node.zeros_of(0);
    const std::int64_t first = (node.bracket.lo + step - 1) / step * step;
    if (first <= node.bracket.hi) node.bracket.lo = static_cast<std::int32_t>(first);
  }
  node.phase = !weighted && node.inside <= node.context.gather_limit ? Phase::gather : Phase::count;
  if (node.phase == Phase::gather) return;
  if (one_place.all && node.wanted.slack == 0)
    begin_with_ids(node);
  else if (node.outside_unknown)
    narrow_to_bracket(node, std::nullopt);
}

// Each candidate costs every rank about 0.2 us, and a round more of counting one collective. With slack the limit is
// the same everywhere, since the cuts depend on it.
std::uint64_t gather_limit_of(const SearchContext& context, std::span<const CutRequest> wanted) {
  const bool exact = std::ranges::all_of(wanted, [](const CutRequest& own) { return own.slack == 0; });
  const std::uint64_t factor = context.comm.over_network() && exact ? Tuning::kNetworkFactor : 1;
  return factor * std::min(std::max(Tuning::kGatheredTogether / wanted.size(), Tuning::kGatherAlways),
                           context.tuning.gather_max);
}

}  // namespace

u128 threshold_of(const CutRequest& wanted) {
  const Product load = Product(wanted.all.weight) * wanted.left_size;
  return static_cast<u128>(Product((load + wanted.size - 1) / wanted.size));
}

std::vector<CutFound> CutSearch::find(std::span<const CutRequest> wanted) {
  if (wanted.empty()) return {};
  context_.gather_limit = gather_limit_of(context_, wanted);
  std::vector<NodeState> nodes;
  for (const CutRequest& own : wanted) nodes.push_back({context_, own});
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
