// Where integers no longer separate the open quantised points: they are replaced by one key word after the other.
#include <algorithm>

#include "common/base/check.hpp"
#include "common/partition/search/select.hpp"

namespace rcb::partition {
namespace {

constexpr unsigned kKeyBits = 31;
constexpr std::uint64_t kNone = ~std::uint64_t{0};

}  // namespace

void Selector::measure_words(std::size_t node, std::span<std::uint64_t> bounds) {
  const std::size_t from = states_[node].word;
  const auto look = [bounds](std::size_t word, std::uint64_t own) {
    bounds[2 * word] = std::min(bounds[2 * word], own);
    bounds[2 * word + 1] = std::min(bounds[2 * word + 1], ~own);
  };
  bool any_lossless = false;
  for (std::size_t w = from; w < axes_; ++w) any_lossless |= lossless(node, w);
  const std::optional<Integers> place = states_[node].replaced ? std::nullopt : nodes_[node].place;
  for (const Span& span : spans_of(node)) {
    const std::span<const QuantisedPoint> open = span.open();
    if (open.empty()) continue;
    QBounds integers;
    if (any_lossless || place) widen(integers, open);
    const bool known = place && integers.lo == *place && integers.hi == *place;
    spent_.traffic.bytes += open.size() * sizeof(QuantisedPoint);
    std::array<const double*, geometry::kDimsMax> x{};
    std::array<double, geometry::kDimsMax> first{};
    std::array<bool, geometry::kDimsMax> same{true, true, true};
    for (std::size_t w = from; w < axes_; ++w) {
      const auto axis = static_cast<std::size_t>(nodes_[node].axes[w]);
      if (lossless(node, w)) {
        look(w, static_cast<std::uint64_t>(integers.lo[axis] >> zeros_of(node, w)));
        look(w, static_cast<std::uint64_t>(integers.hi[axis] >> zeros_of(node, w)));
        continue;
      }
      x[w] = particles_.position[axis] + span.base;
      first[w] = x[w][open[0].index];
      look(w, geometry::order_bits(first[w]));
    }
    if (known) continue;  // all have the first one's coordinates (ids are measured only after integers were replaced)
    spent_.traffic.bytes += open.size() * (sizeof(QuantisedPoint) + (axes_ - from) * sizeof(double) +
                                           (states_[node].by_id ? sizeof(Id) : 0));
    // Mostly all coordinates are equal, or the search would not have come here: one pass finds that out.
    if (x[0] != nullptr && x[1] != nullptr && x[2] != nullptr) {
      for (const QuantisedPoint& point : open) {
        same[0] &= x[0][point.index] == first[0];
        same[1] &= x[1][point.index] == first[1];
        same[2] &= x[2][point.index] == first[2];
      }
    } else {
      for (std::size_t w = from; w < axes_; ++w)
        for (std::size_t i = 0; i < open.size() && x[w] != nullptr; ++i) same[w] &= x[w][open[i].index] == first[w];
    }
    for (std::size_t w = from; w < axes_; ++w)
      for (std::size_t i = 0; i < open.size() && !same[w]; ++i) look(w, geometry::order_bits(x[w][open[i].index]));
    for (std::size_t i = 0; i < open.size() && states_[node].by_id; ++i)
      look(axes_, static_cast<std::uint64_t>(particles_.id_of(span.base + open[i].index)));
  }
}

// A key word with one value only is decided; the integers are replaced by the first one with more. On a lossless axis
// its bounds are the node's; others are measured among the open quantised points.
void Selector::next_word() {
  std::vector<std::size_t> measured;
  for (const std::size_t node : in_phase(Phase::next_word)) {
    State& state = states_[node];
    if (!state.replaced && state.lo == state.hi) state.uniform = state.lo;
    // A single integer decides the word if it determines the coordinate.
    const bool decided = state.replaced ? state.shift == 0 : state.word == 0 && lossless(node, 0);
    if (state.lo == state.hi && decided) state.word += state.words;
    state.words = 1;
    RCB_CHECK(state.word < words_, "two particles have the same id");
    if (state.word > 0 && lossless(node, state.word)) {
      const WordValues own = steps_of(node, state.word);
      const std::uint64_t both =
          lossless(node, state.word + 1) ? own.count * steps_of(node, state.word + 1).count : ~std::uint64_t{0};
      if (both <= std::uint64_t{1} << kKeyBits) {
        state.words = 2;
        enter(node, 0, both - 1);
      } else {
        enter(node, own.first, own.first + own.count - 1);
      }
    } else if (state.word == axes_ && !state.by_id) {
      const auto [least, greatest] = known_ids(node);
      enter(node, least, greatest);
    } else {
      measured.push_back(node);
    }
  }
  if (measured.empty()) return;
  // The least value of every word and the complement of the greatest, so that one minimum gives both.
  Buffer<std::uint64_t> bounds(measured.size() * words_ * 2);
  std::fill(bounds.begin(), bounds.end(), kNone);
  for (std::size_t m = 0; m < measured.size(); ++m) {
    const std::span<std::uint64_t> own = bounds.span().subspan(m * words_ * 2, words_ * 2);
    measure_words(measured[m], own);
    if (states_[measured[m]].by_id) continue;
    const auto [least, greatest] = known_ids(measured[m]);
    own[2 * axes_] = least;
    own[2 * axes_ + 1] = ~greatest;
  }
  spent_.reductions += all_min_in_messages(comm_, bounds.span());
  for (std::size_t m = 0; m < measured.size(); ++m) {
    State& state = states_[measured[m]];
    const auto lo = [&] { return bounds[(m * words_ + state.word) * 2]; };
    const auto hi = [&] { return ~bounds[(m * words_ + state.word) * 2 + 1]; };
    note_place(measured[m], bounds.span().subspan(m * words_ * 2, words_ * 2));
    // All have one coordinate, hence one integer, which restore() can put back.
    if (!state.replaced && lo() == hi() && !lossless(measured[m], 0))
      state.uniform = maps_[axis_of(measured[m])](geometry::value_of_order_bits(lo()));
    while (lo() == hi()) {
      RCB_CHECK(state.word + 1 < words_, "two particles have the same id");
      ++state.word;
    }
    enter(measured[m], lo(), hi());
  }
}

// If all open quantised points turn out to lie in one place, so do all of the node's that have their integers: a
// quantised point that isn't open has another integer on the cut axis.
void Selector::note_place(std::size_t node, std::span<const std::uint64_t> bounds) {
  if (states_[node].word > 0 || states_[node].replaced) return;
  Integers place{};
  for (std::size_t w = 0; w < axes_; ++w) {
    const std::uint64_t value = bounds[2 * w];
    if (value != ~bounds[2 * w + 1]) return;
    const auto axis = static_cast<std::size_t>(nodes_[node].axes[w]);
    place[axis] = lossless(node, w) ? static_cast<std::int32_t>(value << zeros_of(node, w))
                                    : maps_[axis](geometry::value_of_order_bits(value));
  }
  found_[node].place = place;
}

std::array<std::uint64_t, 2> Selector::known_ids(std::size_t node) {
  if (!ids_) {
    std::array<std::uint64_t, 2> least{kNone, kNone};
    for (std::size_t i = 0; i < particles_.count; ++i) {
      const auto id = static_cast<std::uint64_t>(particles_.id_of(i));
      least[0] = std::min(least[0], id);
      least[1] = std::min(least[1], ~id);
    }
    spent_.traffic.bytes += particles_.count * sizeof(Id);
    comm_.all_min(least);
    ++spent_.reductions;
    ids_ = {least[0], ~least[1]};
  }
  const CutRequest& ask = nodes_[node];
  return {std::max((*ids_)[0], static_cast<std::uint64_t>(ask.id_first)),
          std::min((*ids_)[1], static_cast<std::uint64_t>(ask.id_last))};
}

void Selector::enter(std::size_t node, std::uint64_t lo, std::uint64_t hi) {
  State& state = states_[node];
  found_[node].ids_kept =
      nodes_[node].keep_ids && state.word == axes_ && shift_to((*ids_)[1] - (*ids_)[0], kKeyBits) == 0;
  state.phase = Phase::count;
  state.rounds = 0;
  set_range(node, lo, hi);
  write_words(node);
  state.replaced = true;
}

// The integers hold this word from here on, and its values lie in [lo, hi]. Kept ids count from the least of all.
void Selector::set_range(std::size_t node, std::uint64_t lo, std::uint64_t hi) {
  State& state = states_[node];
  const bool kept = found_[node].ids_kept;
  state.by_id = state.word == axes_;
  state.base = kept ? (*ids_)[0] : lo;
  state.shift = kept ? 0 : shift_to(hi - lo, kKeyBits);
  state.lo = static_cast<std::int32_t>((lo - state.base) >> state.shift);
  state.hi = static_cast<std::int32_t>((hi - state.base) >> state.shift);
}

Selector::WordValues Selector::steps_of(std::size_t node, std::size_t word) const {
  const auto axis = static_cast<std::size_t>(nodes_[node].axes[word]);
  const unsigned zeros = zeros_of(node, word);
  const std::int32_t first = nodes_[node].bounds.lo[axis] >> zeros;
  const std::int32_t last = nodes_[node].bounds.hi[axis] >> zeros;
  return {axis, zeros, static_cast<std::uint64_t>(first), static_cast<std::uint64_t>(last - first) + 1};
}

// Replaces the integers by two key words as one number.
void Selector::write_both(Span& span, std::size_t axis, const WordValues& one, const WordValues& other) {
  const auto factor = static_cast<std::uint32_t>(other.count);
  const auto base = static_cast<std::uint32_t>(one.first) * factor + static_cast<std::uint32_t>(other.first);
  for (QuantisedPoint& point : span.open())
    point.q[axis] = static_cast<std::int32_t>(static_cast<std::uint32_t>(point.q[one.axis] >> one.zeros) * factor +
                                              static_cast<std::uint32_t>(point.q[other.axis] >> other.zeros) - base);
}

// Ids of particles that lie anywhere: the processor can't tell which come next.
void Selector::write_ids(Span& span, std::size_t axis, const State& state) const {
  constexpr std::size_t kAhead = 16;
  const std::span<QuantisedPoint> open = span.open();
  for (std::size_t i = 0; i < open.size(); ++i) {
    if (i + kAhead < open.size()) __builtin_prefetch(&particles_.id_of(span.base + open[i + kAhead].index));
    const auto id = static_cast<std::uint64_t>(particles_.id_of(span.base + open[i].index));
    open[i].q[axis] = static_cast<std::int32_t>((id - state.base) >> state.shift);
  }
}

void Selector::write_words(std::size_t node) {
  State& state = states_[node];
  const std::size_t axis = axis_of(node);
  const unsigned zeros = zeros_of(node, state.word);
  const std::size_t from = state.word < axes_ ? static_cast<std::size_t>(nodes_[node].axes[state.word]) : 0;
  note_pass(node, 2 * sizeof(QuantisedPoint) + (lossless(node, state.word) ? 0 : sizeof(double)));
  for (Span& span : spans_of(node)) {
    if (!state.replaced) {
      span.replaced = span.middle;
      span.replaced_last = span.upper;
    }
    if (state.words == 2)
      write_both(span, axis, steps_of(node, state.word), steps_of(node, state.word + 1));
    else if (lossless(node, state.word))
      for (QuantisedPoint& point : span.open())
        point.q[axis] = (point.q[from] >> zeros) - static_cast<std::int32_t>(state.base);
    else if (state.word == axes_)
      write_ids(span, axis, state);
    else
      for (QuantisedPoint& point : span.open())
        point.q[axis] =
            static_cast<std::int32_t>((word_of(node, state.word, span.base + point.index) - state.base) >> state.shift);
  }
}

// Puts the quantised coordinates of the cut axis back in place.
void Selector::restore(std::size_t node) {
  const State& state = states_[node];
  if (!state.replaced || found_[node].ids_kept) return;
  const std::size_t axis = axis_of(node);
  for (Span& span : spans_of(node)) {
    spent_.traffic.bytes += (2 * sizeof(QuantisedPoint) + (state.uniform ? 0 : sizeof(double))) *
                            static_cast<std::size_t>(span.replaced_last - span.replaced);
    for (QuantisedPoint& point : std::span(span.replaced, span.replaced_last)) {
      point.q[axis] = state.uniform ? *state.uniform : maps_[axis](particles_.position[axis][span.base + point.index]);
    }
  }
}

}  // namespace rcb::partition
