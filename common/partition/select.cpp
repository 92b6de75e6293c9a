// The search itself: brackets, rounds, the stash. How the few candidates left are gathered is in
// select_candidates.cpp.
#include "common/partition/select.hpp"

#include <algorithm>
#include <bit>

#include <boost/multiprecision/cpp_int.hpp>

#include "common/partition/wide_sum.hpp"

namespace rcb::partition {
namespace {

using Wide = boost::multiprecision::uint512_t;

constexpr std::size_t kBinsMin = 256;
constexpr std::size_t kNodesBatch = 8192;  // bounds the histogram's memory
constexpr std::uint64_t kNone = ~std::uint64_t{0};

}  // namespace

void Selector::select(std::span<SelectNode> nodes, std::span<const std::int32_t> label) {
  for (std::size_t first = 0; first < nodes.size(); first += kNodesBatch)
    select_batch(nodes.subspan(first, std::min(kNodesBatch, nodes.size() - first)), static_cast<std::int32_t>(first),
                 label);
}

void Selector::select_batch(std::span<SelectNode> nodes, std::int32_t first_label,
                            std::span<const std::int32_t> label) {
  nodes_ = nodes;
  first_label_ = first_label;
  states_.assign(nodes.size(), State{});
  neighbours_.clear();
  plan_round();  // the gather limit of the first choice: as if all nodes were refined
  for (std::size_t n = 0; n < nodes.size(); ++n) start(n);
  if (any(Phase::refine)) {
    plan_round();
    count_all(label);
    reduce_histogram();
  }
  if (any(Phase::refine) || any(Phase::next_word) || any(Phase::gather)) stash_all(label);
  while (any(Phase::refine) || any(Phase::next_word)) {
    if (any(Phase::next_word)) enter_next_words();
    plan_round();
    count_stash();
    reduce_histogram();
  }
  gather_candidates();
  find_neighbours(label);
}

bool Selector::any(Phase phase) const {
  return std::ranges::any_of(states_, [phase](const State& state) { return state.phase == phase; });
}

void Selector::start(std::size_t node) {
  SelectNode& ask = nodes_[node];
  State& state = states_[node];
  if (ask.empty || (!weighted() && ask.rank >= ask.count)) {
    ask.right_empty = true;
    return;
  }
  state.lo = ask.lo;
  state.hi = ask.hi;
  if (weighted()) {
    const Wide wanted = Wide(ask.weight) * ask.left_size;
    state.threshold = static_cast<u128>(Wide((wanted + ask.size - 1) / ask.size));
    if (state.threshold == 0) {  // no weight: left takes nothing
      state.phase = Phase::neighbour;
      neighbours_.push_back({.node = node, .heavy_before = false, .from_start = true, .bound = {}});
      return;
    }
    state.inside = kNone;
  } else {
    state.inside = ask.count;
  }
  state.phase = Phase::refine;
  settle(node);
}

// After the bracket or the count has changed: what comes next for the node?
void Selector::settle(std::size_t node) {
  State& state = states_[node];
  if (state.inside * record_words() <= bins_ * cell_words_ && state.inside != kNone) {
    state.phase = Phase::gather;
    return;
  }
  // Before any particle was stashed the next word may be entered on the bounds alone.
  state.phase = Phase::refine;
  while (state.lo[state.word] == state.hi[state.word]) {
    CHECK(state.word + 1 < words_, "two particles have the same id");
    ++state.word;
  }
}

// Who is refined in the next round, and in how many bins: as many as one message holds, at least 256.
void Selector::plan_round() {
  refining_.clear();
  for (std::size_t n = 0; n < states_.size(); ++n)
    if (states_[n].phase == Phase::refine) {
      states_[n].slot = refining_.size();
      refining_.push_back(n);
    }
  const std::size_t nodes = std::max<std::size_t>(refining_.empty() ? states_.size() : refining_.size(), 1);
  bins_ = std::max(kBinsMin, std::bit_floor(kMessageWordsMax / (nodes * cell_words_)));
  histogram_.resize(refining_.size() * bins_ * cell_words_);
  std::fill(histogram_.begin(), histogram_.end(), 0);
}

void Selector::set_probes(bool refining_only) {
  probes_.assign(states_.size(), Probe{});
  for (std::size_t n = 0; n < states_.size(); ++n) {
    const State& state = states_[n];
    const bool refining = state.phase == Phase::refine;
    if (!refining && (refining_only || state.phase == Phase::done || state.phase == Phase::neighbour)) continue;
    Probe& probe = probes_[n];
    if (state.word < axes_) probe.x = particles_.position[static_cast<std::size_t>(nodes_[n].axes[state.word])];
    probe.lo = state.lo[state.word];
    probe.span = state.hi[state.word] - probe.lo;
    const auto width = static_cast<unsigned>(std::bit_width(probe.span));
    const auto bin_bits = static_cast<unsigned>(std::bit_width(bins_) - 1);
    probe.shift = width > bin_bits ? width - bin_bits : 0;
    probe.cells = state.slot * bins_ * cell_words_;
  }
}

void Selector::add(std::size_t cell, std::size_t particle) {
  ++histogram_[cell];
  if (!weighted()) return;
  const u128 weight = (*scale_)(particles_.weight[particle]);
  // Carried at once, so that no number of particles overflows a limb.
  const std::span<std::uint64_t, kLimbs> limbs(&histogram_[cell + 1], kLimbs);
  std::ranges::copy(limbs_of(value_of_limbs(limbs) + weight), limbs.begin());
}

void Selector::count_all(std::span<const std::int32_t> label) {
  set_probes(true);
  const std::size_t nodes = states_.size();
  for (std::size_t i = 0; i < label.size(); ++i) {
    const auto node = static_cast<std::uint32_t>(label[i] - first_label_);
    if (node >= nodes) continue;
    const Probe& probe = probes_[node];
    const std::uint64_t word =
        probe.x != nullptr ? geometry::image(probe.x[i]) : static_cast<std::uint64_t>(particles_.id[i]);
    const std::uint64_t offset = word - probe.lo;
    if (offset > probe.span) continue;
    add(probe.cells + (offset >> probe.shift) * cell_words_, i);
  }
}

void Selector::stash_all(std::span<const std::int32_t> label) {
  set_probes(false);
  stash_word_.clear();
  stash_node_.clear();
  stash_index_.clear();
  const std::size_t nodes = states_.size();
  for (std::size_t i = 0; i < label.size(); ++i) {
    const auto node = static_cast<std::uint32_t>(label[i] - first_label_);
    if (node >= nodes) continue;
    const Probe& probe = probes_[node];
    const std::uint64_t word =
        probe.x != nullptr ? geometry::image(probe.x[i]) : static_cast<std::uint64_t>(particles_.id[i]);
    if (word - probe.lo > probe.span) continue;
    stash_word_.push_back(word);
    stash_node_.push_back(static_cast<std::int32_t>(node));
    stash_index_.push_back(i);
  }
}

void Selector::count_stash() {
  set_probes(false);
  std::size_t kept = 0;
  for (std::size_t i = 0; i < stash_word_.size(); ++i) {
    const auto node = static_cast<std::size_t>(stash_node_[i]);
    const Probe& probe = probes_[node];
    const std::uint64_t offset = stash_word_[i] - probe.lo;
    if (offset > probe.span) continue;
    stash_word_[kept] = stash_word_[i];
    stash_node_[kept] = stash_node_[i];
    stash_index_[kept] = stash_index_[i];
    ++kept;
    if (states_[node].phase == Phase::refine)
      add(probe.cells + (offset >> probe.shift) * cell_words_, stash_index_[kept - 1]);
  }
  stash_word_.resize(kept);
  stash_node_.resize(kept);
  stash_index_.resize(kept);
}

void Selector::reduce_histogram() {
  const std::size_t node_words = bins_ * cell_words_;
  const std::size_t group = std::max<std::size_t>(kMessageWordsMax / node_words, 1) * node_words;
  for (std::size_t at = 0; at < histogram_.size(); at += group) {
    comm_.all_sum(histogram_.span().subspan(at, std::min(group, histogram_.size() - at)));
    ++rounds_;
    ++reductions_;
  }
  for (const std::size_t node : refining_) narrow(node);
}

// Takes the bin that holds the wanted key as the new bracket.
void Selector::narrow(std::size_t node) {
  State& state = states_[node];
  const Probe& probe = probes_[node];
  for (std::size_t bin = 0; bin < bins_; ++bin) {
    const std::uint64_t* cell = &histogram_[probe.cells + bin * cell_words_];
    u128 weight = 0;
    if (weighted()) weight = value_of_limbs(std::span<const std::uint64_t, kLimbs>(cell + 1, kLimbs));
    const bool holds =
        weighted() ? state.weight_below + weight >= state.threshold : state.below + cell[0] > nodes_[node].rank;
    if (!holds) {
      state.below += cell[0];
      state.weight_below += weight;
      continue;
    }
    std::uint64_t& lo = state.lo[state.word];
    std::uint64_t& hi = state.hi[state.word];
    lo += std::uint64_t{bin} << probe.shift;
    hi = std::min(hi - lo, (std::uint64_t{1} << probe.shift) - 1) + lo;
    state.inside = cell[0];
    if (lo == hi && state.inside * record_words() > bins_ * cell_words_)
      state.phase = Phase::next_word;
    else
      settle(node);
    return;
  }
  CHECK(false, "no bin holds the wanted key");
}

void Selector::enter_next_words() {
  std::vector<std::size_t> entering;
  std::vector<std::int32_t> place(states_.size(), -1);
  for (std::size_t n = 0; n < states_.size(); ++n)
    if (states_[n].phase == Phase::next_word) {
      place[n] = static_cast<std::int32_t>(entering.size());
      entering.push_back(n);
      CHECK(states_[n].word + 1 < words_, "two particles have the same id");
    }
  // Least and complement of the greatest of every word, so that one minimum gives both.
  Buffer<std::uint64_t> bounds(entering.size() * words_ * 2);
  std::fill(bounds.begin(), bounds.end(), kNone);
  for (std::size_t i = 0; i < stash_word_.size(); ++i) {
    const auto node = static_cast<std::size_t>(stash_node_[i]);
    if (place[node] < 0 || stash_word_[i] != states_[node].lo[states_[node].word]) continue;
    std::uint64_t* own = &bounds[static_cast<std::size_t>(place[node]) * words_ * 2];
    for (std::size_t w = states_[node].word + 1; w < words_; ++w) {
      const std::uint64_t word = word_of(node, w, stash_index_[i]);
      own[2 * w] = std::min(own[2 * w], word);
      own[2 * w + 1] = std::min(own[2 * w + 1], ~word);
    }
  }
  comm_.all_min(bounds.span());
  count_reductions(bounds.size());
  std::vector<std::size_t> old_word(states_.size(), 0);
  for (std::size_t e = 0; e < entering.size(); ++e) {
    State& state = states_[entering[e]];
    old_word[entering[e]] = state.word;
    for (std::size_t w = state.word + 1; w < words_; ++w) {
      state.lo[w] = bounds[(e * words_ + w) * 2];
      state.hi[w] = ~bounds[(e * words_ + w) * 2 + 1];
    }
    settle(entering[e]);
  }
  // What is stashed becomes the new word; entries of other values leave now, since their word is gone.
  std::size_t kept = 0;
  for (std::size_t i = 0; i < stash_word_.size(); ++i) {
    const auto node = static_cast<std::size_t>(stash_node_[i]);
    const State& state = states_[node];
    std::uint64_t word = stash_word_[i];
    if (place[node] >= 0) {
      if (word != state.lo[old_word[node]]) continue;
      word = word_of(node, state.word, stash_index_[i]);
    }
    stash_word_[kept] = word;
    stash_node_[kept] = stash_node_[i];
    stash_index_[kept] = stash_index_[i];
    ++kept;
  }
  stash_word_.resize(kept);
  stash_node_.resize(kept);
  stash_index_.resize(kept);
}

std::uint64_t Selector::word_of(std::size_t node, std::size_t word, std::size_t particle) const {
  if (word == axes_) return static_cast<std::uint64_t>(particles_.id[particle]);
  return geometry::image(particles_.position[static_cast<std::size_t>(nodes_[node].axes[word])][particle]);
}

KeyWords Selector::key_words(std::size_t node, std::size_t particle) const {
  KeyWords key{};
  for (std::size_t w = 0; w < words_; ++w) key[w] = word_of(node, w, particle);
  return key;
}

}  // namespace rcb::partition
