// NodeState: how far the search of one node's cut has come; and the steps of CutSearch, which share it.
#pragma once

#include <vector>

#include "common/partition/search/cut_search.hpp"

namespace rcb::partition {

// What a node waits for.
enum class Phase : std::uint8_t {
  done,
  count,      // a histogram of its undecided points
  next_word,  // another key word in place of their integers
  gather,     // their keys, since they are few
  neighbour,  // the key next to a bound
};

// No particle has these: the first word of a finite coordinate is neither 0 nor all ones.
inline constexpr KeyWords kLeastKey{};
inline constexpr KeyWords kGreatestKey{~std::uint64_t{0}, ~std::uint64_t{0}, ~std::uint64_t{0}, ~std::uint64_t{0}};

struct NodeState {
  SearchContext& context;
  const CutRequest& wanted;
  CutFound found{};
  Phase phase = Phase::done;
  u128 threshold = 0;  // with weights: threshold_of()

  // The undecided points' integers lie in the bracket.
  Interval bracket{};
  Load below{};                  // points and wholes below the bracket
  std::uint64_t inside = 0;      // undecided points, all ranks'; with weights not known before the first histogram
  bool outside_unknown = false;  // some points lie outside of `within`, nobody knows yet how many; `inside` has them
  int rounds = 0;                // since the integers hold what they hold

  // The integers hold the coordinates or, if they were replaced, `count` key words from the first one on; if that is
  // one, (its value - base) >> shift.
  struct HeldWords {
    bool replaced = false;
    bool by_id = false;  // they hold the id, or have held it
    std::size_t first = 0;
    std::size_t count = 1;
    std::uint64_t base = 0;
    unsigned shift = 0;
    std::optional<std::int32_t> uniform;  // all integers that were replaced were this one
  };
  HeldWords words{};

  // The key next after `bound` is wanted. First backward: the last particle before it that has weight becomes the
  // bound.
  struct Neighbour {
    KeyWords bound = kLeastKey;
    bool weighted_before = false;
  };
  Neighbour neighbour{};

  std::span<Segment> segments() const { return wanted.points.segments; }
  // The axis whose integers are searched.
  std::size_t axis() const { return wanted.keep_ids ? 0 : axis_of(0); }
  std::size_t axis_of(std::size_t word) const { return at(wanted.axes[word]); }
  // True if a key word's axis is lossless: its integers may then stand for the word.
  bool lossless(std::size_t word) const { return word < context.axes() && context.maps[axis_of(word)].lossless(); }
  // The trailing zero bits of that axis' integers; 0 if it is not lossless.
  unsigned zeros_of(std::size_t word) const { return lossless(word) ? context.maps[axis_of(word)].zeros() : 0; }

  std::uint64_t word_of(std::size_t word, std::size_t particle) const {
    return word == context.axes() ? static_cast<std::uint64_t>(context.particles.id_of(particle))
                                  : geometry::order_bits(context.particles.position[axis_of(word)][particle]);
  }
  KeyWords key(std::size_t particle) const {
    KeyWords key{};
    for (std::size_t w = 0; w <= context.axes(); ++w) key[w] = word_of(w, particle);
    return key;
  }
  // A key's integer on the cut axis.
  std::int32_t integer(const KeyWords& key) const {
    return context.maps[axis_of(0)](geometry::value_of_order_bits(key[0]));
  }

  // Whether the prefix of this load holds the wanted key.
  bool reached(const Load& prefix) const {
    return context.weighted() ? prefix.weight >= threshold : prefix.count > wanted.rank;
  }
  // Says where the wanted key is, once it is known what load the points below `within` and in it have. If it isn't in
  // it, the search has ended.
  bool is_within(const Load& points_below, const Load& points_within) {
    outside_unknown = false;
    found.points_below = points_below;
    found.points_within = points_within;
    below = wanted.before + points_below;
    inside = points_within.count;
    if (reached(below))
      found.where = CutFound::Where::below;
    else if (!reached(below + points_within))
      found.where = CutFound::Where::above;
    if (found.where != CutFound::Where::within) phase = Phase::done;
    return found.where == CutFound::Where::within;
  }
  // Notes a pass over the undecided points that reads and writes so many bytes of each.
  void note_pass(std::size_t bytes) const {
    for (const Segment& segment : segments()) context.cost.bytes += bytes * segment.undecided().size();
  }
};

using NodeStates = std::span<NodeState* const>;

// What a node's histogram tells.
struct Crossing {
  Load points_below;  // if outside_unknown: of the points below `within`, and in it; else 0
  Load points_within;
  std::optional<std::size_t> bin;  // the one that holds the wanted key
  unsigned shift = 0;              // a bin has 2^shift integers
  Load below;                      // of the points and wholes below that bin
  Load inside;                     // of its points
};

// histogram.cpp: the undecided points of all ranks are counted (with weights, weighed) by their integers on the cut
// axis. The sums of many nodes share messages of bounded size. Collective (one reduction a message).
std::vector<Crossing> count_round(SearchContext& context, NodeStates nodes);

// ties.cpp: where integers no longer separate the undecided points, they are replaced by one key word after the other.
// A word with one value only is decided; the first one with more is entered. Collective (at most one reduction a
// message, and one the first time that ids are needed).
void next_words(SearchContext& context, NodeStates nodes);
// The points lie in one place: only ids can tell them apart. Collective (one reduction, the first time).
void begin_with_ids(NodeState& node);
// Puts the integers of the cut axis back in place, unless ids are kept there. Local.
void restore_integers(NodeState& node);

// candidates.cpp: the few candidates left in each node are gathered on all ranks with their whole keys, and the cut is
// chosen among them. Collective (one gather a message).
void choose_among_candidates(SearchContext& context, NodeStates nodes);
// With weights the key may lie just outside of the bracket: it is searched among all of the node's points. Collective
// (at most two gathers a message).
void find_neighbours(SearchContext& context, NodeStates nodes);

}  // namespace rcb::partition
