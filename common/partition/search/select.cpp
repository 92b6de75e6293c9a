// The search itself: rounds, brackets, and the division of the quantised points. Where integers no longer separate
// them, select_words.cpp goes on; the last candidates are gathered in select_candidates.cpp.
#include "common/partition/search/select.hpp"

#include <algorithm>
#include <bit>
#include <limits>
#include <numeric>
#include <span>
#include <utility>

#include <boost/multiprecision/cpp_int.hpp>

#include "common/base/check.hpp"
#include "common/comm/wide_sum.hpp"

namespace rcb::partition {
namespace {

using Wide = boost::multiprecision::uint512_t;

constexpr std::size_t kBinsMin = 64;
constexpr std::size_t kWeightedBinsMax = 256;     // with weights, where a cell has four words
constexpr int kRoundsMax = 3;                     // before the integers are replaced by a key word
constexpr std::uint64_t kGatherAlways = 8;        // so few candidates aren't worth a histogram
constexpr std::uint64_t kGatheredTogether = 512;  // candidates of all nodes
// So many times as many are gathered where the integers separate nothing any more, since key words cost more passes.
constexpr std::uint64_t kSpentFactor = 8;
constexpr std::uint64_t kNetworkFactor = 4;  // likewise, where a collective costs a network's latency

// Counts that share the words of a message.
using Count8 = std::uint8_t __attribute__((may_alias));
using Count16 = std::uint16_t __attribute__((may_alias));
using Count32 = std::uint32_t __attribute__((may_alias));

}  // namespace

std::uint64_t all_min_in_messages(comm::Comm& comm, std::span<std::uint64_t> values) {
  std::uint64_t messages = 0;
  for (; !values.empty(); ++messages) {
    const std::size_t count = std::min(kMessageWordsMax, values.size());
    comm.all_min(values.first(count));
    values = values.subspan(count);
  }
  return messages;
}

u128 threshold_of(const CutRequest& wanted) {
  const Wide load = Wide(wanted.weight) * wanted.left_size;
  return static_cast<u128>(Wide((load + wanted.size - 1) / wanted.size));
}

std::vector<CutFound> Selector::select(std::span<const CutRequest> nodes) {
  nodes_ = nodes;
  found_.assign(nodes.size(), CutFound{});
  states_.assign(nodes.size(), State{});
  neighbours_.clear();
  gather_limit_ = nodes.empty() ? 0 : gather_limit();
  for (std::size_t n = 0; n < nodes.size(); ++n) start(n);
  do {
    count_round();
    next_word();
  } while (!in_phase(Phase::count).empty());
  gather_candidates();
  find_neighbours();
  return std::move(found_);
}

std::vector<std::size_t> Selector::in_phase(Phase phase) const {
  std::vector<std::size_t> found;
  for (std::size_t n = 0; n < states_.size(); ++n)
    if (states_[n].phase == phase) found.push_back(n);
  return found;
}

void Selector::start(std::size_t node) {
  const CutRequest& ask = nodes_[node];
  State& state = states_[node];
  found_[node].ids_kept = ask.ids_kept;
  for (Span& span : spans_of(node)) {
    span.middle = span.first;
    span.upper = span.last;
  }
  if (!ask.search) {
    found_[node].right_empty = true;
    for (Span& span : spans_of(node)) span.middle = span.last;
    return;
  }
  const bool by_id = ask.coincident && ask.slack == 0;
  state.phase = by_id && !ask.ids_kept ? Phase::next_word : Phase::count;
  if (by_id) state.word = axes_;
  state.lo = ask.bounds.lo[axis_of(node)];
  state.hi = ask.bounds.hi[axis_of(node)];
  if (ask.ids_kept) {
    const auto [least, greatest] = known_ids(node);
    set_range(node, least, greatest);
    state.replaced = true;
  }
  state.below = ask.below;
  state.weight_below = ask.weight_below;
  if (!weighted()) {
    state.inside = ask.count;
    if (state.inside <= gather_limit_) state.phase = Phase::gather;
    if (state.phase == Phase::count && ask.expected) narrow_to_expected(node);
    return;
  }
  state.threshold = threshold_of(ask);
  if (state.threshold == 0) find_next_key({.node = node});  // no weight at all: the left side takes nothing
}

void Selector::narrow_to_expected(std::size_t node) {
  const auto [least, most] = *nodes_[node].expected;
  const std::size_t axis = axis_of(node);
  for (Span& span : spans_of(node)) {
    const std::int32_t lo = span.bounds.lo[axis];
    const std::int32_t hi = span.bounds.hi[axis];
    if (lo < least) span.middle = hi < least ? span.last : split_open(span, axis, least);
    if (hi > most) span.upper = lo > most ? span.middle : split_open(span, axis, most + 1);
  }
  states_[node].expected = true;
  states_[node].lo = least;
  states_[node].hi = most;
}

void Selector::leave_expected(std::size_t node) {
  const CutRequest& ask = nodes_[node];
  State& state = states_[node];
  const std::int32_t step = std::int32_t{1} << zeros_of(node, 0);  // between integers
  if (ask.rank < state.below) {
    state.hi = state.lo - step;
    state.lo = ask.bounds.lo[axis_of(node)];
    state.inside = state.below - ask.below;
    state.below = ask.below;
    for (Span& span : spans_of(node)) span.upper = std::exchange(span.middle, span.first);
  } else {
    state.lo = state.hi + step;
    state.hi = ask.bounds.hi[axis_of(node)];
    state.inside = ask.below + ask.count - state.below;
    for (Span& span : spans_of(node)) span.middle = std::exchange(span.upper, span.last);
  }
  choose_next_phase(node, ask.count);
  state.rounds = 0;
}

// As split(), of a span's open points. Where the range of its integers tells that few are on one side, only these are
// moved.
QuantisedPoint* Selector::split_open(const Span& span, std::size_t axis, std::int32_t at) {
  constexpr std::int64_t kFew = 8;
  const std::int64_t left = std::int64_t{at} - span.bounds.lo[axis];
  const std::int64_t right = std::int64_t{span.bounds.hi[axis]} - at;
  const bool few = left * kFew < right || right * kFew < left;
  spent_.traffic.bytes += (few ? 1 : 2) * sizeof(QuantisedPoint) * span.open().size();
  if (!few) return split(span.open(), axis, at);
  return left < right ? split_few(span.open(), axis, at) : split_few_back(span.open(), axis, at);
}

// Each candidate costs every rank about 0.2 us, and a round more of counting one collective. With slack the limit is
// the same everywhere, since the cuts depend on it.
std::uint64_t Selector::gather_limit() const {
  const bool exact = std::ranges::all_of(nodes_, [](const CutRequest& node) { return node.slack == 0; });
  const std::uint64_t factor = comm_.over_network() && exact ? kNetworkFactor : 1;
  return factor * std::min(std::max(kGatheredTogether / nodes_.size(), kGatherAlways), limits_.gather_max);
}

// Decides how a node goes on after its bracket has changed. Integers that separate little more are replaced by a key
// word, unless it is cheaper to gather what is left.
void Selector::choose_next_phase(std::size_t node, std::uint64_t before) {
  State& state = states_[node];
  ++state.rounds;
  const bool tied = state.rounds > 1 && state.inside > before / 2;
  const bool spent = state.lo == state.hi || (!state.replaced && (tied || state.rounds >= kRoundsMax));
  const bool cheap = state.lo == state.hi && !state.replaced && lossless(node, 0) && lossless(node, 1);
  if (state.inside <= gather_limit_ || (spent && !cheap && state.inside <= kSpentFactor * gather_limit_))
    state.phase = Phase::gather;
  else if (spent)
    state.phase = Phase::next_word;
}

void Selector::note_pass(std::size_t node, std::size_t bytes) {
  for (const Span& span : spans_of(node)) spent_.traffic.bytes += bytes * span.open().size();
}

// Calls apply() with the counts of the message's cells from word `at` on.
template <typename Apply>
void Selector::with_counts(std::size_t at, const Apply& apply) {
  std::uint64_t* const words = &message_[at];
  switch (per_word_) {
    case 8:
      return apply(reinterpret_cast<Count8*>(words));
    case 4:
      return apply(reinterpret_cast<Count16*>(words));
    case 2:
      return apply(reinterpret_cast<Count32*>(words));
    default:
      return apply(words);
  }
}

// Carries are propagated at once, so that no limb overflows, however many particles are added.
void Selector::add_weight(std::size_t at, u128 weight) {
  const std::span<std::uint64_t, comm::kLimbs> limbs(&message_[at + 1], comm::kLimbs);
  std::ranges::copy(comm::limbs_of(comm::value_of_limbs(limbs) + weight), limbs.begin());
}

std::size_t Selector::crossing(std::size_t node, std::size_t bins, std::size_t at, BinSum& found) {
  State& state = states_[node];
  std::size_t bin = 0;
  if (weighted()) {
    for (; bin < bins; ++bin) {
      const std::uint64_t* const words = &message_[at + (1 + bin) * cell_words_];
      found = {words[0], comm::value_of_limbs(std::span<const std::uint64_t, comm::kLimbs>(words + 1, comm::kLimbs))};
      if (state.weight_below + found.weight >= state.threshold) return bin;
      state.below += found.count;
      state.weight_below += found.weight;
    }
  } else {
    with_counts(at, [&](const auto* cells) {
      const auto counts = std::span(cells + 1, bins);
      state.below += cells[0];
      if (state.expected) state.inside = std::accumulate(counts.begin(), counts.end(), std::uint64_t{0});
      if (nodes_[node].rank < state.below) bin = bins;
      for (; bin < bins && state.below + counts[bin] <= nodes_[node].rank; ++bin) state.below += counts[bin];
      if (bin < bins) found = {counts[bin], 0};
    });
  }
  RCB_CHECK(bin < bins || state.expected, "a bin holds the wanted key");
  return bin;
}

// Histograms of the integers on the cut axis, with as many bins as fit in one message for all nodes, behind a cell with
// what lies below an expected bracket. Where no count can reach 2^8 (2^16, 2^32), several share a word.
void Selector::count_round() {
  const std::vector<std::size_t> asked = in_phase(Phase::count);
  if (asked.empty()) return;
  ++spent_.rounds;
  std::uint64_t most = 0;
  for (const std::size_t node : asked) most = std::max(most, states_[node].inside);
  per_word_ = weighted() ? 1 : most < 0x100 ? 8 : most < 0x10000 ? 4 : most < 0x100000000 ? 2 : 1;
  const std::size_t fit = kMessageWordsMax * per_word_ / (cell_words_ * asked.size());
  const std::size_t most_bins =
      std::min<std::size_t>(limits_.bins_max, weighted() ? kWeightedBinsMax : limits_.bins_max);
  const std::size_t least_bins = std::min(kBinsMin, most_bins);
  const std::size_t bins = std::clamp(std::bit_floor(std::max<std::size_t>(fit, 1)), least_bins, most_bins);
  const auto bin_bits = static_cast<unsigned>(std::bit_width(bins) - 1);
  const auto words_of = [this](std::size_t count) { return (count * cell_words_ + per_word_ - 1) / per_word_; };
  const std::size_t group = std::max<std::size_t>(kMessageWordsMax / words_of(bins), 1);
  for (std::size_t first = 0; first < asked.size(); first += group) {
    const auto own = std::span(asked).subspan(first, std::min(group, asked.size() - first));
    const auto shift = [&](std::size_t node) {
      const State& state = states_[node];
      // A lossless axis' integers are multiples of 2^zeros: narrower bins would stay empty.
      const unsigned least = state.replaced ? 0 : zeros_of(node, 0);
      return std::max(shift_to(static_cast<std::uint64_t>(state.hi - state.lo), bin_bits), least);
    };
    // Bins beyond the widest bracket would stay empty: they aren't sent.
    std::size_t used = 1;
    for (const std::size_t node : own)
      used = std::max(used, (static_cast<std::size_t>(states_[node].hi - states_[node].lo) >> shift(node)) + 1);
    const std::size_t words = words_of(1 + used);
    message_.resize(own.size() * words);
    std::fill(message_.begin(), message_.end(), 0);
    for (std::size_t n = 0; n < own.size(); ++n) count_node(own[n], shift(own[n]), used, n * words);
    comm_.all_sum(message_.span());
    ++spent_.reductions;
    for (std::size_t n = 0; n < own.size(); ++n) take_count(own[n], shift(own[n]), used, n * words);
  }
}

void Selector::count_node(std::size_t node, unsigned shift, std::size_t bins, std::size_t at) {
  const State& state = states_[node];
  const std::int32_t lo = state.lo;
  const std::size_t axis = axis_of(node);
  if (state.expected) {
    std::size_t below = 0;
    std::size_t open = 0;
    for (const Span& span : spans_of(node)) {
      below += static_cast<std::size_t>(span.middle - span.first);
      open += span.open().size();
    }
    with_counts(at, [&](auto* cells) {
      using Count = std::remove_cvref_t<decltype(cells[0])>;
      cells[0] = static_cast<Count>(below);
      if (state.lo == state.hi) cells[1] = static_cast<Count>(open);
    });
    if (state.lo == state.hi) return;
  }
  note_pass(node, sizeof(QuantisedPoint) + (weighted() ? sizeof(double) : 0));
  if (weighted()) {
    for (const Span& span : spans_of(node))
      for (const QuantisedPoint& point : span.open()) {
        const std::size_t own = at + (1 + (static_cast<std::uint32_t>(point.q[axis] - lo) >> shift)) * cell_words_;
        ++message_[own];
        add_weight(own, (*scale_)(particles_.weight[span.base + point.index]));
      }
    return;
  }
  bins_.resize(2 * bins);
  std::fill(bins_.begin(), bins_.end(), 0);
  const std::span<std::uint32_t> even = bins_.span().first(bins);
  const std::span<std::uint32_t> odd = bins_.span().subspan(bins);
  std::uint64_t counted = 0;
  const auto add = [&] {
    with_counts(at, [&](auto* counts) {
      using Count = std::remove_cvref_t<decltype(counts[0])>;
      for (std::size_t b = 0; b < bins; ++b) counts[1 + b] = static_cast<Count>(counts[1 + b] + even[b] + odd[b]);
    });
  };
  for (const Span& span : spans_of(node)) {
    if (counted + span.open().size() > std::numeric_limits<std::uint32_t>::max()) {  // no count may overflow
      add();
      std::fill(bins_.begin(), bins_.end(), 0);
      counted = 0;
    }
    counted += span.open().size();
    count_bins(span.open(), axis, lo, shift, even, odd);
  }
  add();
}

// The bin that holds the wanted key becomes the bracket.
void Selector::take_count(std::size_t node, unsigned shift, std::size_t bins, std::size_t at) {
  State& state = states_[node];
  BinSum found;
  const std::size_t bin = crossing(node, bins, at, found);
  if (std::exchange(state.expected, false) && bin == bins) return leave_expected(node);
  const std::uint64_t before = state.inside;
  if (take_near(node, shift, bin, found)) return;
  state.inside = found.count;
  const std::int32_t lo = state.lo + static_cast<std::int32_t>(bin << shift);
  const bool uniform = !state.replaced && lossless(node, 0) && shift == zeros_of(node, 0);
  const auto step = uniform ? 0 : static_cast<std::int32_t>((std::uint64_t{1} << shift) - 1);
  narrow(node, lo, state.hi - lo > step ? lo + step : state.hi, found.count < before / 16);
  choose_next_phase(node, before);
}

// With slack: cuts between two bins, if that is near enough to the target.
bool Selector::take_near(std::size_t node, unsigned shift, std::size_t bin, const BinSum& cell) {
  const CutRequest& ask = nodes_[node];
  const State& state = states_[node];
  if (ask.slack == 0 || state.replaced) return false;
  const u128 wanted =
      weighted() ? static_cast<u128>(Wide(Wide(ask.weight) * ask.left_size / ask.size)) : u128{ask.rank};
  const u128 before = weighted() ? state.weight_below : state.below;
  const u128 after = before + (weighted() ? cell.weight : cell.count);
  const auto off = [wanted](u128 got) { return got < wanted ? wanted - got : got - wanted; };
  const bool take = off(after) < off(before);
  // Behind the last bin the integer may not fit in 32 bits.
  const std::uint64_t beyond = static_cast<std::uint64_t>(state.lo) + (std::uint64_t{bin + (take ? 1 : 0)} << shift);
  const auto top = static_cast<std::uint64_t>(ask.bounds.hi[axis_of(node)]);
  if (off(take ? after : before) > ask.slack || beyond > top) return false;
  const auto q = static_cast<std::int32_t>(beyond);
  CutFound& found = found_[node];
  found.left_count = state.below + (take ? cell.count : 0);
  found.left_weight = state.weight_below + (take ? cell.weight : 0);
  const Key key = key_between(maps_[axis_of(node)].first_value(q), static_cast<int>(axes_));
  for (std::size_t w = 0; w < axes_; ++w) found.key[w] = geometry::order_bits(key.at[w]);
  note_pass(node, 2 * sizeof(QuantisedPoint));
  for (Span& span : spans_of(node)) span.middle = span.upper = split(span.open(), axis_of(node), q);
  states_[node].phase = Phase::done;
  return true;
}

void Selector::narrow(std::size_t node, std::int32_t lo, std::int32_t hi, bool few) {
  State& state = states_[node];
  const std::size_t axis = axis_of(node);
  if (lo > state.lo) {
    note_pass(node, 2 * sizeof(QuantisedPoint));
    for (Span& span : spans_of(node)) span.middle = split(span.open(), axis, lo);
  }
  if (hi < state.hi) {
    note_pass(node, (few ? 1 : 2) * sizeof(QuantisedPoint));
    for (Span& span : spans_of(node)) span.upper = (few ? split_few : split)(span.open(), axis, hi + 1);
  }
  state.lo = lo;
  state.hi = hi;
}

// The right side has the quantised points whose key isn't less than the cut's.
void Selector::divide(std::size_t node) {
  const CutFound& found = found_[node];
  restore(node);
  for (Span& span : spans_of(node)) {
    if (found.right_empty) {
      span.middle = span.upper = span.last;
      continue;
    }
    span.middle = std::partition(span.middle, span.upper, [&](const QuantisedPoint& point) {
      return key_words(node, span.base + point.index) < found.key;
    });
    span.upper = span.middle;
  }
}

std::uint64_t Selector::word_of(std::size_t node, std::size_t word, std::size_t particle) const {
  if (word == axes_) return static_cast<std::uint64_t>(particles_.id_of(particle));
  return geometry::order_bits(particles_.position[static_cast<std::size_t>(nodes_[node].axes[word])][particle]);
}

KeyWords Selector::key_words(std::size_t node, std::size_t particle) const {
  KeyWords key{};
  for (std::size_t w = 0; w < words_; ++w) key[w] = word_of(node, w, particle);
  return key;
}

}  // namespace rcb::partition
