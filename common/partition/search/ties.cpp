#include "common/base/check.hpp"
#include "common/partition/balance/bounds.hpp"
#include "common/partition/search/node_state.hpp"

namespace rcb::partition {
namespace {

constexpr unsigned kWordBits = 30;

// Calls use(point, value) for each undecided point. Values are in the order of this key word: on a lossless axis
// integers, which lie side by side, else the words themselves.
template <typename Use>
void for_each_value(const NodeState& node, std::size_t word, const Use& use) {
  const bool lossless = node.lossless(word);
  node.note_pass(sizeof(QuantisedPoint) + (lossless ? 0 : sizeof(std::uint64_t)));
  for (const Segment& segment : node.segments()) {
    if (lossless)
      for (QuantisedPoint& point : segment.undecided()) use(point, at(point.q[node.axis_of(word)]));
    else
      for (QuantisedPoint& point : segment.undecided()) use(point, node.word_of(word, segment.base + point.index));
  }
}

// The values of each coordinate from the current word on. Local.
void measure_coordinates(const NodeState& node, AllMinMax& all) {
  for (std::size_t word = node.word; word < node.context.axes(); ++word) {
    WordRange range;
    for_each_value(node, word, [&range](const QuantisedPoint&, std::uint64_t value) {
      range.first = std::min(range.first, value);
      range.last = std::max(range.last, value);
    });
    all.add(range.first, range.last);
  }
}

// Collective (one reduction, the first time).
WordRange all_ids(SearchContext& context) {
  if (!context.all_ids) {
    WordRange range;
    for (std::size_t i = 0; i < context.particles.count; ++i) {
      const auto id = static_cast<std::uint64_t>(context.particles.id_of(i));
      range.first = std::min(range.first, id);
      range.last = std::max(range.last, id);
    }
    AllMinMax all;
    all.add(range.first, range.last);
    context.cost.bytes += context.particles.count * sizeof(Id);
    context.cost.reductions += all.reduce(context.comm);
    all.take(range.first, range.last);
    context.all_ids = range;
  }
  return *context.all_ids;
}

// Goes to the first word with more than one value, and tells its values: a coordinate, as they were measured, or the
// id. Collective (as all_ids).
WordRange next_range(NodeState& node, AllMinMax& measured) {
  const std::size_t first = std::exchange(node.word, node.context.axes());
  WordRange found;
  for (std::size_t word = first; word < node.context.axes(); ++word) {
    WordRange range;
    measured.take(range.first, range.last);
    if (range.first == range.last || node.word < word) continue;
    node.word = word;
    found = range;
  }
  return node.word < node.context.axes() ? found : all_ids(node.context);
}

// The integers are to hold the current word, which has these values.
void write_word(NodeState& node, const WordRange& range) {
  if (!node.replaced) {
    node.replaced_integer = node.bracket.lo;
    for (const Segment& segment : node.segments()) node.replaced_points.push_back(segment.undecided());
  }
  node.replaced = true;
  node.base = range.first;
  node.shift = std::max(shift_to(range.last - range.first, kWordBits), node.zeros_of(node.word));
  node.bracket = {0, static_cast<std::int32_t>((range.last - range.first) >> node.shift)};
  node.found.by_id = node.request.points.one_place && node.shift == 0;
  node.phase = Phase::count;
  for_each_value(
      node, node.word,
      [axis = node.searched_axis(), base = node.base, shift = node.shift](QuantisedPoint& point, std::uint64_t value) {
        point.q[axis] = static_cast<std::int32_t>((value - base) >> shift);
      });
}

}  // namespace

// A word of which only some bits are known yet (shift > 0) is entered once more with those that follow.
void next_words(SearchContext& context, NodeStates nodes) {
  AllMinMax measured;
  for (const NodeState* node : nodes)
    if (node->shift == 0) measure_coordinates(*node, measured);
  context.cost.reductions += measured.reduce(context.comm);
  for (NodeState* node : nodes) {
    RCB_CHECK(node->word <= context.axes(), "two particles have the same id");
    const std::uint64_t first = node->base + (at(node->bracket.lo) << node->shift);
    write_word(*node, node->shift > 0 ? WordRange{first, first + (std::uint64_t{1} << node->shift) - 1}
                                      : next_range(*node, measured));
  }
}

void restore_integers(NodeState& node) {
  if (node.request.points.one_place) return;
  for (const std::span<QuantisedPoint> points : node.replaced_points) {
    node.context.cost.bytes += 2 * points.size_bytes();
    for (QuantisedPoint& point : points) point.q[node.axis_of(0)] = node.replaced_integer;
  }
}

}  // namespace rcb::partition
