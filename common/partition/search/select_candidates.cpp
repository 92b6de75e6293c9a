// The end of a search: the few candidates left in each node are gathered on all ranks with their whole keys, and the
// cut is selected among them. With weights the wanted key may lie just outside the bracket; then it is searched among
// all of the node's particles.
#include <algorithm>

#include <boost/multiprecision/cpp_int.hpp>

#include "common/comm/gather.hpp"
#include "common/partition/search/select.hpp"

namespace rcb::partition {
namespace {

using Wide = boost::multiprecision::uint512_t;

// No particle has these: the first word of a finite coordinate is neither 0 nor all ones.
constexpr KeyWords kLeastKey{};
constexpr KeyWords kGreatestKey{~std::uint64_t{0}, ~std::uint64_t{0}, ~std::uint64_t{0}, ~std::uint64_t{0}};

}  // namespace

void Selector::gather_candidates() {
  const std::vector<std::size_t> gathering = in_phase(Phase::gather);
  const std::size_t limit = kMessageWordsMax / candidate_words();
  for (std::size_t first = 0; first < gathering.size();) {
    std::size_t last = first;
    std::uint64_t total = 0;
    while (last < gathering.size() && (last == first || total + states_[gathering[last]].inside <= limit))
      total += states_[gathering[last++]].inside;
    gather_group(std::span(gathering).subspan(first, last - first));
    first = last;
  }
}

void Selector::gather_group(std::span<const std::size_t> group) {
  std::vector<std::uint64_t> mine;
  for (const std::size_t node : group)
    for (const Span& span : spans_of(node))
      for (const QuantisedPoint& point : span.open()) {
        const std::size_t particle = span.base + point.index;
        const KeyWords key = key_words(node, particle);
        mine.push_back(node);
        mine.insert(mine.end(), key.begin(), key.begin() + static_cast<std::ptrdiff_t>(words_));
        if (!weighted()) continue;
        const u128 weight = (*scale_)(particles_.weight[particle]);
        mine.push_back(static_cast<std::uint64_t>(weight));
        mine.push_back(static_cast<std::uint64_t>(weight >> 64U));
      }
  const auto all = comm::all_gather_few_values<std::uint64_t>(comm_, mine);
  ++spent_.reductions;
  std::vector<Candidate> candidates;
  candidates.reserve(all.size() / candidate_words());
  for (std::size_t at = 0; at < all.size(); at += candidate_words()) {
    Candidate candidate{all[at], {}, 0};
    for (std::size_t w = 0; w < words_; ++w) candidate.key[w] = all[at + 1 + w];
    if (weighted()) candidate.weight = all[at + 1 + words_] | (u128{all[at + 2 + words_]} << 64U);
    candidates.push_back(candidate);
  }
  std::ranges::sort(candidates, [](const Candidate& a, const Candidate& b) {
    return a.node != b.node ? a.node < b.node : a.key < b.key;
  });
  for (std::size_t first = 0; first < candidates.size();) {
    std::size_t last = first;
    while (last < candidates.size() && candidates[last].node == candidates[first].node) ++last;
    const std::span<const Candidate> own = std::span(candidates).subspan(first, last - first);
    RCB_CHECK(own.size() == states_[own[0].node].inside, "the candidates are those counted");
    states_[own[0].node].phase = Phase::done;
    if (weighted())
      pick_weighted(own);
    else
      pick(own);
    if (states_[own[0].node].phase == Phase::done) divide(own[0].node);
    first = last;
  }
}

void Selector::pick(std::span<const Candidate> candidates) {
  const std::size_t node = candidates[0].node;
  const std::uint64_t rank = nodes_[node].rank;
  CutFound& found = found_[node];
  found.left_count = rank;
  found.key = found.lowest_relied_on = found.highest_relied_on = candidates[rank - states_[node].below].key;
}

// The left side takes the prefix with the weight nearest to the wanted one; on a tie, and among prefixes of the same
// weight, the shortest.
void Selector::pick_weighted(std::span<const Candidate> candidates) {
  const std::size_t index = candidates[0].node;
  const CutRequest& node = nodes_[index];
  CutFound& found = found_[index];
  const State& state = states_[index];
  u128 before = state.weight_below;
  std::size_t crossing = 0;
  while (crossing < candidates.size() && before + candidates[crossing].weight < state.threshold)
    before += candidates[crossing++].weight;
  RCB_CHECK(crossing < candidates.size(), "the wanted weight is reached inside the bracket");
  const u128 after = before + candidates[crossing].weight;
  found.lowest_relied_on = found.highest_relied_on = candidates[crossing].key;
  const Wide wanted = Wide(node.weight) * node.left_size;
  if (Wide(after) * node.size - wanted < wanted - Wide(before) * node.size) {
    found.left_weight = after;
    if (crossing + 1 < candidates.size())
      found.key = found.highest_relied_on = candidates[crossing + 1].key;
    else
      find_next_key({.node = index, .bound = candidates[crossing].key});
    return;
  }
  found.left_weight = before;
  while (crossing > 0 && candidates[crossing - 1].weight == 0) --crossing;
  if (crossing > 0 || state.below == 0) {
    found.key = candidates[crossing].key;
    found.lowest_relied_on = candidates[crossing > 0 ? crossing - 1 : 0].key;
  } else if (state.weight_below == 0) {
    find_next_key({.node = index});
  } else {
    find_next_key({.node = index, .weighted_before_bound = true, .bound = candidates[0].key});
  }
}

void Selector::find_next_key(const Neighbour& wanted) {
  neighbours_.push_back(wanted);
  states_[wanted.node].phase = Phase::neighbour;
}

void Selector::find_neighbours() {
  if (neighbours_.empty()) return;
  std::vector<Neighbour> backward;
  std::ranges::copy_if(neighbours_, std::back_inserter(backward), &Neighbour::weighted_before_bound);
  if (!backward.empty()) {
    const std::vector<KeyWords> keys = nearest(backward, true);
    auto key = keys.begin();
    for (Neighbour& neighbour : neighbours_) {
      if (!neighbour.weighted_before_bound) continue;
      RCB_CHECK(*key != kLeastKey || nodes_[neighbour.node].below > 0, "weight lies below the bracket");
      neighbour.bound = found_[neighbour.node].lowest_relied_on = *key++;
    }
  }
  const std::vector<KeyWords> keys = nearest(neighbours_, false);
  for (std::size_t n = 0; n < neighbours_.size(); ++n) {
    const std::size_t node = neighbours_[n].node;
    CutFound& cut = found_[node];
    cut.right_empty = keys[n] == kGreatestKey;
    cut.key = keys[n];
    cut.highest_relied_on = std::max(cut.highest_relied_on, keys[n]);
    if (neighbours_[n].bound == kLeastKey) {
      cut.lowest_relied_on = keys[n];
      cut.failed = nodes_[node].below > 0;
    }
    states_[node].phase = Phase::done;
    for (Span& span : spans_of(node)) {
      span.middle = span.first;
      span.upper = span.last;
    }
    divide(node);
  }
}

std::vector<KeyWords> Selector::nearest(std::span<const Neighbour> wanted, bool backward) {
  const KeyWords none = backward ? kLeastKey : kGreatestKey;
  std::vector<KeyWords> keys(wanted.size(), none);
  const auto offer = [&](std::size_t n, const KeyWords& key) {
    keys[n] = backward ? std::max(keys[n], key) : std::min(keys[n], key);
  };
  for (std::size_t n = 0; n < wanted.size(); ++n)
    for (const Span& span : spans_of(wanted[n].node))
      for (const QuantisedPoint& point : span.all()) {
        const std::size_t particle = span.base + point.index;
        const KeyWords key = key_words(wanted[n].node, particle);
        if (backward ? key < wanted[n].bound && (*scale_)(particles_.weight[particle]) > 0 : wanted[n].bound < key)
          offer(n, key);
      }
  struct Found {
    std::uint64_t n;
    KeyWords key;
  };
  const std::size_t group =
      std::max<std::size_t>(kMessageBytesMax / (sizeof(Found) * static_cast<std::size_t>(comm_.size())), 1);
  for (std::size_t first = 0; first < wanted.size(); first += group) {
    std::vector<Found> mine;
    for (std::size_t n = first; n < std::min(first + group, wanted.size()); ++n)
      if (keys[n] != none) mine.push_back({n, keys[n]});
    for (const Found& found : comm::all_gather_few_values<Found>(comm_, mine)) offer(found.n, found.key);
    ++spent_.reductions;
  }
  return keys;
}

}  // namespace rcb::partition
