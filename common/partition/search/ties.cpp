#include "common/base/check.hpp"
#include "common/partition/balance/bounds.hpp"
#include "common/partition/kernels/kernels.hpp"
#include "common/partition/search/node_state.hpp"

namespace rcb::partition {
namespace {

constexpr unsigned kWordBits = 31;
constexpr std::uint64_t kNoValue = ~std::uint64_t{0};

// The values of a key word.
struct WordRange {
  std::uint64_t first = kNoValue;
  std::uint64_t last = 0;

  std::uint64_t count() const { return last - first + 1; }
};

// On a lossless axis, in units of 2^zeros of the integers.
WordRange steps_of(const NodeState& node, std::size_t word) {
  const std::size_t axis = node.axis_of(word);
  const QBounds& bounds = node.wanted.points.bounds;
  return {at(bounds.lo[axis] >> node.zeros_of(word)), at(bounds.hi[axis] >> node.zeros_of(word))};
}

// What is known of the ids of a node's points: the bounds of all particles' ids, and what the request tells. Collective
// (one reduction, the first time).
WordRange known_ids(const NodeState& node) {
  SearchContext& context = node.context;
  if (!context.all_ids) {
    std::uint64_t least = kNoValue;
    std::uint64_t most = 0;
    for (std::size_t i = 0; i < context.particles.count; ++i) {
      const auto id = static_cast<std::uint64_t>(context.particles.id_of(i));
      least = std::min(least, id);
      most = std::max(most, id);
    }
    AllMinMax all;
    all.add(least, most);
    context.cost.bytes += context.particles.count * sizeof(Id);
    context.cost.reductions += all.reduce(context.comm);
    all.take(least, most);
    context.all_ids = {least, most};
  }
  const OnePlace& one_place = node.wanted.points.one_place;
  return {std::max((*context.all_ids)[0], static_cast<std::uint64_t>(one_place.id_first)),
          std::min((*context.all_ids)[1], static_cast<std::uint64_t>(one_place.id_last))};
}

// The integers are to hold this word, which has these values. Kept ids count from the least of all.
void set_range(NodeState& node, const WordRange& range) {
  NodeState::HeldWords& words = node.words;
  const bool kept = node.found.ids_kept;
  words.by_id = words.first == node.context.axes();
  words.base = kept ? (*node.context.all_ids)[0] : range.first;
  words.shift = kept ? 0 : shift_to(range.last - range.first, kWordBits);
  node.bracket.lo = static_cast<std::int32_t>((range.first - words.base) >> words.shift);
  node.bracket.hi = static_cast<std::int32_t>((range.last - words.base) >> words.shift);
  node.phase = Phase::count;
}

void write_words(NodeState& node) {
  constexpr std::ptrdiff_t kAhead = 16;
  const particles::ParticleView& particles = node.context.particles;
  const auto [replaced, by_id, word, count, base, shift, uniform] = node.words;
  const std::size_t axis = node.axis();
  const bool lossless = node.lossless(word);
  node.note_pass(2 * sizeof(QuantisedPoint) + (lossless ? 0 : sizeof(double)));
  for (Segment& segment : node.segments()) {
    if (!replaced) {
      segment.replaced = segment.middle;
      segment.replaced_last = segment.upper;
    }
    const auto write = [&](const auto& value) {
      for (QuantisedPoint& point : segment.undecided()) point.q[axis] = static_cast<std::int32_t>(value(point));
    };
    if (count == 2) {  // as one number
      const std::array<std::size_t, 2> from{node.axis_of(word), node.axis_of(word + 1)};
      const std::array<unsigned, 2> zeros{node.zeros_of(word), node.zeros_of(word + 1)};
      const WordRange next = steps_of(node, word + 1);
      write([&](const QuantisedPoint& point) {
        return (at(point.q[from[0]] >> zeros[0]) - base) * next.count() + at(point.q[from[1]] >> zeros[1]) - next.first;
      });
    } else if (lossless) {
      write([&, from = node.axis_of(word), zeros = node.zeros_of(word)](const QuantisedPoint& point) {
        return at(point.q[from] >> zeros) - base;
      });
    } else if (by_id) {  // of particles that lie anywhere: the processor can't tell which come next
      write([&](const QuantisedPoint& point) {
        if (segment.upper - &point > kAhead)
          __builtin_prefetch(&particles.id_of(segment.base + (&point + kAhead)->index));
        return (static_cast<std::uint64_t>(particles.id_of(segment.base + point.index)) - base) >> shift;
      });
    } else {
      write([&, x = particles.position[node.axis_of(word)] + segment.base](const QuantisedPoint& point) {
        return (geometry::order_bits(x[point.index]) - base) >> shift;
      });
    }
  }
}

void enter(NodeState& node, const WordRange& range) {
  const std::optional<std::array<std::uint64_t, 2>>& ids = node.context.all_ids;
  node.found.ids_kept = node.wanted.keep_ids && node.words.first == node.context.axes() &&
                        shift_to((*ids)[1] - (*ids)[0], kWordBits) == 0;
  node.rounds = 0;
  set_range(node, range);
  write_words(node);
  node.words.replaced = true;
}

// Enters the next word, if its values are known without a look at the points. Collective (as known_ids).
bool enter_known_word(NodeState& node) {
  NodeState::HeldWords& words = node.words;
  const bool one_left = node.bracket.lo == node.bracket.hi;
  if (!words.replaced && one_left) words.uniform = node.bracket.lo;
  // A single integer decides the word if it determines the coordinate.
  const bool decided = words.replaced ? words.shift == 0 : words.first == 0 && node.lossless(0);
  if (one_left && decided) words.first += words.count;
  words.count = 1;
  RCB_CHECK(words.first <= node.context.axes(), "two particles have the same id");
  if (words.first == node.context.axes() && !words.by_id) {
    enter(node, known_ids(node));
    return true;
  }
  if (words.first == 0 || !node.lossless(words.first)) return false;
  WordRange range = steps_of(node, words.first);
  if (node.lossless(words.first + 1)) {
    const std::uint64_t both = range.count() * steps_of(node, words.first + 1).count();
    if (both <= std::uint64_t{1} << kWordBits) {
      words.count = 2;
      range.last = range.first + both - 1;
    }
  }
  enter(node, range);
  return true;
}

// For each key word from the current one on: the least value among the undecided points and the complement of the
// greatest. On a lossless axis integers in units of 2^zeros, else order-preserving bits. Local.
void measure_words(const NodeState& node, std::span<std::uint64_t> bounds) {
  const SearchContext& context = node.context;
  const NodeState::HeldWords& words = node.words;
  const std::optional<Integers>& where = node.wanted.points.one_place.where;
  const auto look = [bounds](std::size_t word, std::uint64_t value) {
    bounds[2 * word] = std::min(bounds[2 * word], value);
    bounds[2 * word + 1] = std::min(bounds[2 * word + 1], ~value);
  };
  for (const Segment& segment : node.segments()) {
    const std::span<const QuantisedPoint> points = segment.undecided();
    if (points.empty()) continue;
    context.cost.bytes += points.size() * sizeof(QuantisedPoint);
    QBounds integers;
    kernels().widen(integers, points);
    const bool one_place = !words.replaced && where && integers.lo == *where && integers.hi == *where;
    for (std::size_t w = words.first; w < context.axes(); ++w) {
      const std::size_t axis = node.axis_of(w);
      if (node.lossless(w)) {
        look(w, at(integers.lo[axis] >> node.zeros_of(w)));
        look(w, at(integers.hi[axis] >> node.zeros_of(w)));
        continue;
      }
      const double* const x = context.particles.position[axis] + segment.base;
      const double first = x[points[0].index];
      look(w, geometry::order_bits(first));
      if (one_place) continue;
      // Mostly all coordinates are equal, or the search would not have come here: a quick pass finds that out.
      context.cost.bytes += points.size() * (sizeof(QuantisedPoint) + sizeof(double));
      bool same = true;
      for (const QuantisedPoint& point : points) same &= x[point.index] == first;
      for (std::size_t i = 0; i < points.size() && !same; ++i) look(w, geometry::order_bits(x[points[i].index]));
    }
    if (!words.by_id) continue;
    context.cost.bytes += points.size() * (sizeof(QuantisedPoint) + sizeof(Id));
    for (const QuantisedPoint& point : points)
      look(context.axes(), node.word_of(context.axes(), segment.base + point.index));
  }
}

// If all undecided points turn out to lie in one place, so do all of the node's that have their integers: a point that
// isn't undecided has another integer on the cut axis.
void note_place(NodeState& node, std::span<const std::uint64_t> bounds) {
  if (node.words.first > 0 || node.words.replaced) return;
  Integers place{};
  for (std::size_t w = 0; w < node.context.axes(); ++w) {
    const std::uint64_t value = bounds[2 * w];
    if (value != ~bounds[2 * w + 1]) return;
    const std::size_t axis = node.axis_of(w);
    place[axis] = node.lossless(w) ? static_cast<std::int32_t>(value << node.zeros_of(w))
                                   : node.context.maps[axis](geometry::value_of_order_bits(value));
  }
  node.found.where_in_one_place = place;
}

// Decides the words that have one value only, and enters the next one.
void enter_measured_word(NodeState& node, std::span<std::uint64_t> bounds) {
  std::size_t& word = node.words.first;
  const std::size_t id = node.context.axes();
  const auto same = [&] { return bounds[2 * word] == ~bounds[2 * word + 1]; };
  note_place(node, bounds);
  // All have one coordinate, hence one integer, which restore_integers() can put back.
  if (!node.words.replaced && same() && !node.lossless(0))
    node.words.uniform = node.context.maps[node.axis()](geometry::value_of_order_bits(bounds[0]));
  while (word < id && same()) ++word;
  enter(node, word == id && !node.words.by_id ? known_ids(node) : WordRange{bounds[2 * word], ~bounds[2 * word + 1]});
}

}  // namespace

void begin_with_ids(NodeState& node) {
  node.words.first = node.context.axes();
  node.bracket.lo = node.bracket.hi = node.wanted.points.bounds.lo[node.axis()];
  node.phase = Phase::next_word;
  if (!node.found.ids_kept) return;
  set_range(node, known_ids(node));
  node.words.replaced = true;
}

void next_words(SearchContext& context, NodeStates nodes) {
  std::vector<NodeState*> measured;
  for (NodeState* node : nodes)
    if (!enter_known_word(*node)) measured.push_back(node);
  // The least value of every word and the complement of the greatest, so that one minimum gives both.
  const std::size_t words = 2 * (context.axes() + 1);
  std::vector<std::uint64_t> bounds(measured.size() * words, kNoValue);
  const auto own = [&](std::size_t m) { return std::span(bounds).subspan(m * words, words); };
  for (std::size_t m = 0; m < measured.size(); ++m) measure_words(*measured[m], own(m));
  context.cost.reductions += comm::all_min_in_messages(context.comm, bounds);
  for (std::size_t m = 0; m < measured.size(); ++m) enter_measured_word(*measured[m], own(m));
}

void restore_integers(NodeState& node) {
  if (!node.words.replaced || node.found.ids_kept) return;
  const std::size_t axis = node.axis();
  const std::optional<std::int32_t> uniform = node.words.uniform;
  for (Segment& segment : node.segments()) {
    const double* const x = node.context.particles.position[axis] + segment.base;
    const std::span<QuantisedPoint> points(segment.replaced, segment.replaced_last);
    node.context.cost.bytes += (2 * sizeof(QuantisedPoint) + (uniform ? 0 : sizeof(double))) * points.size();
    for (QuantisedPoint& point : points) point.q[axis] = uniform ? *uniform : node.context.maps[axis](x[point.index]);
  }
}

}  // namespace rcb::partition
