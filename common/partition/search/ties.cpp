#include "common/base/check.hpp"
#include "common/partition/balance/bounds.hpp"
#include "common/partition/kernels/kernels.hpp"
#include "common/partition/search/node_state.hpp"

namespace rcb::partition {
namespace {

constexpr unsigned kWordBits = 30;
constexpr std::size_t kAll = ~std::size_t{0};

// Calls use(point, value) for the undecided points, `most` of each segment. Values are in the order of this key word:
// on a lossless axis integers, which lie side by side, else the words themselves.
template <typename Use>
void for_each_value(const NodeState& node, std::size_t word, std::size_t most, const Use& use) {
  constexpr std::ptrdiff_t kAhead = 16;
  const particles::ParticleView& particles = node.context.particles;
  const std::size_t bytes = sizeof(QuantisedPoint) + (node.lossless(word) ? 0 : sizeof(std::uint64_t));
  for (const Segment& segment : node.segments()) {
    const auto each = [&](const auto& value) {
      const std::span<QuantisedPoint> points = segment.undecided().first(std::min(most, segment.undecided().size()));
      node.context.cost.bytes += bytes * points.size();
      for (QuantisedPoint& point : points) use(point, value(point));
    };
    if (node.lossless(word)) {
      each([axis = node.axis_of(word)](const QuantisedPoint& point) { return at(point.q[axis]); });
    } else if (word < node.context.axes()) {
      each([x = particles.position[node.axis_of(word)] + segment.base](const QuantisedPoint& point) {
        return geometry::order_bits(x[point.index]);
      });
    } else {  // of particles that lie anywhere: the processor can't tell which come next
      each([&](const QuantisedPoint& point) {
        if (segment.upper - &point > kAhead)
          __builtin_prefetch(&particles.id_of(segment.base + (&point + kAhead)->index));
        return static_cast<std::uint64_t>(particles.id_of(segment.base + point.index));
      });
    }
  }
}

// The values of the current word, as for_each_value() tells them, if no point must be looked at: where the integers
// told some bits of the word, those that may follow; on a lossless axis the bounds of all points.
std::optional<WordRange> known_range(const NodeState& node) {
  if (node.word.shift > 0) {
    const std::uint64_t first = node.word.base + (at(node.bracket.lo) << node.word.shift);
    return WordRange{first, first + (std::uint64_t{1} << node.word.shift) - 1};
  }
  if (node.word.index == 0 || !node.lossless(node.word.index)) return std::nullopt;
  const QBounds& bounds = node.request.points.bounds;
  return WordRange{at(bounds.lo[node.axis_of(node.word.index)]), at(bounds.hi[node.axis_of(node.word.index)])};
}

// The values of each coordinate from the current word on. Local.
void measure_coordinates(const NodeState& node, AllMinMax& all) {
  const std::optional<Integers>& crowd = node.request.points.crowd;
  QBounds bounds;
  if (crowd && !node.word.replaced)
    for (const Segment& segment : node.segments()) kernels().widen(bounds, segment.undecided());
  const bool same = crowd && bounds.lo == *crowd && bounds.hi == *crowd;
  for (std::size_t word = node.word.index; word < node.context.axes(); ++word) {
    WordRange range;
    for_each_value(node, word, same ? 1 : kAll, [&range](const QuantisedPoint&, std::uint64_t value) {
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
  const std::size_t first = std::exchange(node.word.index, node.context.axes());
  WordRange found;
  for (std::size_t word = first; word < node.context.axes(); ++word) {
    WordRange range;  // all must be taken, in this order
    measured.take(range.first, range.last);
    if (range.first == range.last || node.word.index < word) continue;
    node.word.index = word;
    found = range;
  }
  if (node.word.index < node.context.axes()) return found;
  // A point that isn't undecided has another integer on the cut axis.
  for (const Segment& segment : node.segments())
    if (first == 0 && !node.word.replaced && !segment.undecided().empty()) node.found.crowd = segment.undecided()[0].q;
  return all_ids(node.context);
}

// The integers are to hold the current word, which has these values.
void write_word(NodeState& node, const WordRange& range) {
  if (!node.word.replaced) {
    node.word.replaced_integer = node.bracket.lo;
    for (const Segment& segment : node.segments()) node.word.replaced_points.push_back(segment.undecided());
  }
  node.word.base = range.first;
  node.word.shift = std::max(shift_to(range.last - range.first, kWordBits), node.zeros_of(node.word.index));
  // Later windows of an id are for a few points only.
  if (!node.word.replaced) node.found.by_id = node.request.points.one_place && node.word.shift == 0;
  node.word.replaced = true;
  node.bracket = {0, static_cast<std::int32_t>((range.last - range.first) >> node.word.shift)};
  node.phase = Phase::count;
  for_each_value(node, node.word.index, kAll,
                 [axis = node.searched_axis(), base = node.word.base, shift = node.word.shift](QuantisedPoint& point,
                                                                                               std::uint64_t value) {
                   point.q[axis] = static_cast<std::int32_t>((value - base) >> shift);
                 });
}

}  // namespace

void next_words(SearchContext& context, NodeStates nodes) {
  AllMinMax measured;
  for (const NodeState* node : nodes)
    if (!known_range(*node)) measure_coordinates(*node, measured);
  context.cost.reductions += measured.reduce(context.comm);
  for (NodeState* node : nodes) {
    RCB_CHECK(node->word.index <= context.axes(), "two particles have the same id");
    const std::optional<WordRange> known = known_range(*node);
    write_word(*node, known ? *known : next_range(*node, measured));
  }
}

void restore_integers(NodeState& node) {
  if (node.request.points.one_place) return;
  for (const std::span<QuantisedPoint> points : node.word.replaced_points) {
    node.context.cost.bytes += 2 * points.size_bytes();
    for (QuantisedPoint& point : points) point.q[node.axis_of(0)] = node.word.replaced_integer;
  }
}

}  // namespace rcb::partition
