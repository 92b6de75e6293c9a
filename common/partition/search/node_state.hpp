// NodeState: how far the search of one node's cut has come; and the steps of CutSearch, which share it.
#pragma once

#include <vector>

#include "common/partition/search/cut_search.hpp"

namespace rcb::partition {

// What a node waits for.
enum class Phase : std::uint8_t {
  done,
  count,      // a histogram of its undecided points
  next_word,  // a key word in place of their integers, which are all the same
  gather,     // their keys, since they are few
  neighbour,  // the key next to a bound
};

// No particle has these: the first word of a finite coordinate is neither 0 nor all ones.
inline constexpr KeyWords kLeastKey{};
inline constexpr KeyWords kGreatestKey{~std::uint64_t{0}, ~std::uint64_t{0}, ~std::uint64_t{0}, ~std::uint64_t{0}};

struct NodeState {
  SearchContext& context;
  const CutRequest& request;
  CutFound found{};
  Phase phase = Phase::done;
  u128 threshold = 0;  // with weights: threshold_of()

  // The undecided points' integers lie in the bracket.
  Interval bracket{};
  Load below{};                 // points and wholes below the bracket
  std::uint64_t inside = 0;     // undecided points, all ranks'; with weights not known before the first histogram
  bool counts_outside = false;  // some points lie outside of `within`, nobody knows yet how many; `inside` has them

  // The key word that is searched; the undecided points share the ones before. Integers hold the coordinates or, if
  // they were replaced, (the word - base) >> shift.
  struct Word {
    std::size_t index = 0;
    bool replaced = false;
    std::uint64_t base = 0;
    unsigned shift = 0;
    std::vector<std::span<QuantisedPoint>> replaced_points{};  // this rank's: all integers were the same one
    std::int32_t replaced_integer = 0;
  };
  Word word{};

  // The key next after `bound` is wanted. First backward: the last particle before it that has weight becomes the
  // bound.
  struct Neighbour {
    KeyWords bound = kLeastKey;
    bool weighted_before = false;
  };
  Neighbour neighbour{};

  std::span<Segment> segments() const { return request.points.segments; }
  // The axis whose integers are searched: the cut axis, except that ids which stay have the same axis in all nodes.
  std::size_t searched_axis() const { return request.points.one_place ? 0 : axis_of(0); }
  std::size_t axis_of(std::size_t w) const { return at(request.axes[w]); }
  // True if a key word's axis is lossless: its integers may then stand for the word.
  bool lossless(std::size_t w) const { return w < context.axes() && context.maps[axis_of(w)].lossless(); }
  // The trailing zero bits of that axis' integers; 0 if it is not lossless.
  unsigned zeros_of(std::size_t w) const { return lossless(w) ? context.maps[axis_of(w)].zeros() : 0; }
  // The trailing zero bits of the integers that are searched.
  unsigned zeros() const { return word.replaced ? 0 : zeros_of(0); }

  std::uint64_t word_of(std::size_t w, std::size_t particle) const {
    return w == context.axes() ? static_cast<std::uint64_t>(context.particles.id_of(particle))
                               : geometry::order_bits(context.particles.position[axis_of(w)][particle]);
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
    return context.weighted() ? prefix.weight >= threshold : prefix.count > request.rank;
  }
  // Says where the wanted key is, once it is known what load the points below `within` and in it have. If it isn't in
  // it, the search has ended.
  bool is_within(const Load& points_below, const Load& points_within) {
    counts_outside = false;
    found.points_below = points_below;
    found.points_within = points_within;
    below = request.before + points_below;
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
  Load points_below;  // if counts_outside: of the points below `within`, and in it; else 0
  Load points_within;
  std::optional<std::size_t> bin;  // the one that holds the wanted key
  unsigned shift = 0;              // a bin has 2^shift integers
  Load below;                      // of the points and wholes below that bin
  Load inside;                     // of its points
};

// histogram.cpp: the undecided points of all ranks are counted (with weights, weighed) by their integers on the cut
// axis. The sums of many nodes share messages of bounded size. Collective (one reduction a message).
std::vector<Crossing> count_round(SearchContext& context, NodeStates nodes);

// ties.cpp: where the undecided points have one integer, it is replaced by the first key word that they don't share.
// Collective (at most one reduction a message, and one the first time that ids are needed).
void next_words(SearchContext& context, NodeStates nodes);
// Puts the integers of the cut axis back in place, unless the points all lie in one place. Local.
void restore_integers(NodeState& node);

// candidates.cpp: the few candidates left in each node are gathered on all ranks with their whole keys, and the cut is
// chosen among them. Collective (one gather a message).
void choose_among_candidates(SearchContext& context, NodeStates nodes);
// With weights the key may lie just outside of the bracket: it is searched among all of the node's points. Collective
// (at most two gathers a message).
void find_neighbours(SearchContext& context, NodeStates nodes);

}  // namespace rcb::partition
