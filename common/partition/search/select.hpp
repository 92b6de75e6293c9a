// Selector: exact distributed selection, for all nodes of a tree level together. For each node it finds the smallest
// key of the right side: the same bits on every rank, however the particles are distributed. Afterwards each node's
// quantised points are divided by that key.
//
// Invariants
// 1. The wanted key is that of one of the node's open quantised points (Span); `below` particles have smaller keys than
//    all of these. A round looks at the open quantised points alone.
// 2. Where the key is expected in a range of integers, this is the first bracket if the key is in it; if not, what lies
//    beyond it on the key's side is.
// 3. A round makes a histogram of the open points' integers on the cut axis; the bin that holds the wanted key becomes
//    the bracket, and the quantised points outside of it are no longer open.
// 4. Where integers no longer separate the open points, and these are too many to be gathered, the integers are
//    replaced until the search ends (ids of a coincident node: for good, CutRequest::keep_ids) by the offset of a key
//    word from its least value: key words are the coordinates in the node's axis order, then the id. Earlier words are
//    decided by then. Each round divides a bracket by at least 64: a word takes at most 3 rounds on quantised integers
//    and 13 on windows of 31 bits of it (6 + 6 + 1), whatever the distribution; one that all open points share takes
//    none.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/base/wide.hpp"
#include "common/comm/comm.hpp"
#include "common/partition/balance/load.hpp"
#include "common/partition/search/quantised_points.hpp"
#include "common/partition/search/request.hpp"

namespace rcb::partition {

// A key as words: the coordinates' order-preserving bits in the node's axis order, then the id in [words - 1]; unused
// words are 0.
using KeyWords = std::array<std::uint64_t, geometry::kDimsMax + 1>;

inline constexpr std::size_t kMessageBytesMax = 32 * 1024;
inline constexpr std::size_t kMessageWordsMax = kMessageBytesMax / sizeof(std::uint64_t);

// Comm::all_min in messages of at most kMessageBytesMax; returns their number. Collective.
std::uint64_t all_min_in_messages(comm::Comm& comm, std::span<std::uint64_t> values);

// A node's quantised points, all ranks.
struct NodePoints {
  std::uint64_t count = 0;  // without weights
  u128 weight = 0;          // with weights
  QBounds bounds;           // of their integers
  AxisOrder axes{0, 1, 2};
  bool coincident = false;        // all of these are known to lie in one place: only ids tell them apart
  bool ids_kept = false;          // ids have taken their integers' place: on axis 0, less the least id of all particles
  std::optional<Integers> place;  // those with these integers are known to lie in one place
  Id id_first = 0;                // coincident ones have ids from here
  Id id_last = std::numeric_limits<Id>::max();
};

// A cut that is wanted.
struct CutRequest : NodePoints {
  bool unanswerable = false;  // by the quantised points alone; then all else is unspecified
  bool search = true;         // false: nothing goes right, or it is unanswerable
  std::span<Span> spans;      // its quantised points; afterwards middle == upper, where the right side begins
  bool keep_ids = false;      // of coincident ones: their integers aren't needed any more, ids may take their place
  // Interior particles of the left parts (they have no quantised point).
  std::uint64_t below = 0;
  u128 weight_below = 0;
  // Without weights: wanted is the key in this place (from 0) of the ascending keys of `below` and the quantised
  // points.
  std::uint64_t rank = 0;
  // With weights: the left side takes the prefix with the weight nearest to weight * left_size / size; here `weight` is
  // that of all the node's particles, interior ones too.
  u128 left_size = 0;
  u128 size = 1;
  // The left side may have so many particles (so much weight) more or less than wanted. 0: exact.
  u128 slack = 0;
  // Where the key's first integer is expected; only without weights and slack.
  std::optional<std::array<std::int32_t, 2>> expected;
};

struct CutFound {
  bool ids_kept = false;          // as CutRequest::ids_kept, for both sides
  std::optional<Integers> place;  // as CutRequest::place, where the search has found one
  bool failed = false;            // it depends on interior particles; the rest is unspecified
  bool right_empty = false;
  KeyWords key{};  // smallest key of the right side
  // The least and the greatest key that the cut depends on. It holds if on the cut axis the left parts' interior
  // particles lie below the former and the right parts' above the latter.
  KeyWords lowest_relied_on{};
  KeyWords highest_relied_on{};
  std::uint64_t left_count = 0;  // without weights; includes `below`
  u128 left_weight = 0;          // with weights; includes `weight_below`
};

// With weights: the left side's target, rounded up. The cut lies before or behind the particle whose prefix reaches it.
u128 threshold_of(const CutRequest& wanted);

class Selector {
 public:
  // scale: null without weights. Adds what the search costs to `spent`.
  Selector(comm::Comm& comm, const particles::ParticleView& particles, const AxisMaps& maps, const ExactScale* scale,
           const SearchLimits& limits, PartitionResult& spent)
      : comm_(comm),
        particles_(particles),
        maps_(maps),
        axes_(static_cast<std::size_t>(particles.dims)),
        words_(axes_ + 1),
        scale_(scale),
        limits_(limits),
        spent_(spent),
        cell_words_(scale == nullptr ? 1 : 4) {}

  // The cuts of a level's nodes. Collective.
  std::vector<CutFound> select(std::span<const CutRequest> nodes);

 private:
  enum class Phase : std::uint8_t { done, count, next_word, gather, neighbour };

  // The search of one node.
  struct State {
    Phase phase = Phase::done;
    bool expected = false;  // `below`, and whether the bracket holds the key, aren't known before its first histogram
    std::optional<std::int32_t> uniform;  // all integers that were replaced were this one
    bool replaced = false;                // the integers hold a key word instead: (its value - base) >> shift
    bool by_id = false;                   // the integers hold the id, or have held it
    std::size_t word = 0;
    std::size_t words = 1;  // how many key words the integers hold, from `word` on
    unsigned shift = 0;
    std::uint64_t base = 0;
    int rounds = 0;  // since the integers hold this word
    // The bracket: the open quantised points' integers lie in [lo, hi].
    std::int32_t lo = 0;
    std::int32_t hi = 0;
    std::uint64_t below = 0;
    std::uint64_t inside = 0;
    u128 weight_below = 0;
    u128 threshold = 0;  // with weights: the shortest prefix of at least this weight ends in the bracket
  };
  struct Candidate {
    std::size_t node;
    KeyWords key;
    u128 weight;
  };
  struct BinSum {
    std::uint64_t count = 0;
    u128 weight = 0;
  };
  // A request for the key next to a bound, among all of a node's particles (weights only).
  struct Neighbour {
    std::size_t node = 0;
    // First backward: the last particle before `bound` that has weight becomes the bound.
    bool weighted_before_bound = false;
    KeyWords bound{};  // less than any key: the node's first key is wanted
  };

  void start(std::size_t node);
  // Brackets the node's key where it is expected.
  void narrow_to_expected(std::size_t node);
  // It isn't there: what lies beyond, on the key's side, becomes the bracket.
  void leave_expected(std::size_t node);
  QuantisedPoint* split_open(const Span& span, std::size_t axis, std::int32_t at);
  // Up to so many candidates of a node are gathered instead of counted.
  std::uint64_t gather_limit() const;
  std::vector<std::size_t> in_phase(Phase phase) const;
  void choose_next_phase(std::size_t node, std::uint64_t before);
  // Histograms are summed over ranks in messages of bounded size, for a group of nodes at a time.
  void count_round();
  void count_node(std::size_t node, unsigned shift, std::size_t bins, std::size_t at);
  void take_count(std::size_t node, unsigned shift, std::size_t bins, std::size_t at);
  bool take_near(std::size_t node, unsigned shift, std::size_t bin, const BinSum& cell);
  void narrow(std::size_t node, std::int32_t lo, std::int32_t hi, bool few);
  void next_word();
  // What is known of the ids of a node's particles: the bounds of all particles' ids, and what the request tells.
  // Collective (one reduction, the first time).
  std::array<std::uint64_t, 2> known_ids(std::size_t node);
  // For each key word from the node's current one on: the least value among the open quantised points, and the
  // complement of the greatest; for the id, of what is known unless it is measured. On a lossless axis integers in
  // units of 2^zeros, else order-preserving bits. Local.
  void measure_words(std::size_t node, std::span<std::uint64_t> bounds);
  // The values of a key word on a lossless axis: `count` of them from `first` on, in units of 2^zeros of the integers.
  struct WordValues {
    std::size_t axis;
    unsigned zeros;
    std::uint64_t first;
    std::uint64_t count;
  };
  void note_place(std::size_t node, std::span<const std::uint64_t> bounds);
  WordValues steps_of(std::size_t node, std::size_t word) const;
  static void write_both(Span& span, std::size_t axis, const WordValues& one, const WordValues& other);
  void set_range(std::size_t node, std::uint64_t lo, std::uint64_t hi);
  void write_words(std::size_t node);
  void write_ids(Span& span, std::size_t axis, const State& state) const;
  void restore(std::size_t node);
  void enter(std::size_t node, std::uint64_t lo, std::uint64_t hi);
  template <typename Apply>
  void with_counts(std::size_t at, const Apply& apply);
  void add_weight(std::size_t at, u128 weight);
  // Finds the bin that holds the wanted key, and adds what lies before it to `below` and `weight_below`. `bins` if an
  // expected bracket doesn't hold the key.
  std::size_t crossing(std::size_t node, std::size_t bins, std::size_t at, BinSum& found);

  void gather_candidates();
  void gather_group(std::span<const std::size_t> group);
  void pick(std::span<const Candidate> candidates);
  void pick_weighted(std::span<const Candidate> candidates);
  void find_next_key(const Neighbour& wanted);
  void find_neighbours();
  // The key nearest to each bound: after it or, if backward, before it and with weight > 0. Where there is none, the
  // greatest key that there can be; if backward, the least. Collective.
  std::vector<KeyWords> nearest(std::span<const Neighbour> wanted, bool backward);
  // Divides the open quantised points by the key found. Where it may lie outside of the bracket, all must be open
  // again.
  void divide(std::size_t node);
  // Notes a pass over the open quantised points that reads and writes so many bytes of each.
  void note_pass(std::size_t node, std::size_t bytes);

  bool weighted() const { return scale_ != nullptr; }
  std::size_t axis_of(std::size_t node) const {
    return nodes_[node].keep_ids ? 0 : static_cast<std::size_t>(nodes_[node].axes[0]);
  }
  std::span<Span> spans_of(std::size_t node) const { return nodes_[node].spans; }
  // True if a key word's axis is lossless: the integers may then stand for the word.
  bool lossless(std::size_t node, std::size_t word) const {
    return word < axes_ && maps_[static_cast<std::size_t>(nodes_[node].axes[word])].lossless();
  }
  // The trailing zero bits of that axis' integers; 0 if it is not lossless.
  unsigned zeros_of(std::size_t node, std::size_t word) const {
    return lossless(node, word) ? maps_[static_cast<std::size_t>(nodes_[node].axes[word])].zeros() : 0;
  }
  std::uint64_t word_of(std::size_t node, std::size_t word, std::size_t particle) const;
  KeyWords key_words(std::size_t node, std::size_t particle) const;
  std::size_t candidate_words() const { return words_ + 1 + (weighted() ? 2 : 0); }

  comm::Comm& comm_;
  const particles::ParticleView& particles_;
  const AxisMaps& maps_;
  std::size_t axes_;
  std::size_t words_;
  const ExactScale* scale_;
  const SearchLimits& limits_;
  PartitionResult& spent_;
  std::size_t cell_words_;  // words of a histogram's cell: a count; with weights also three limbs

  std::span<const CutRequest> nodes_;
  std::vector<CutFound> found_;  // [nodes]
  std::vector<State> states_;
  std::uint64_t gather_limit_ = 0;
  std::vector<Neighbour> neighbours_;
  std::optional<std::array<std::uint64_t, 2>> ids_;  // the least and the greatest of all particles
  Buffer<std::uint64_t> message_;
  std::size_t per_word_ = 1;  // counts packed into a word of the message
  Buffer<std::uint32_t> bins_;
};

}  // namespace rcb::partition
