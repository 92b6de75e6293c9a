// Selector: exact distributed selection, for all nodes of a tree level together. Each node asks for the smallest key of
// its right side; the answer is the same bits on every rank, whatever particles lie where. Afterwards each node's
// records stand divided by it.
//
// Invariants
// 1. A node's open records (Span) hold the wanted key; `below` of its records come before them, the rest after. A round
//    looks at the open records alone.
// 2. A round counts the records' integers on the cut axis; the bin that holds the wanted key becomes the bracket, and
//    the records outside of it are open no more.
// 3. Where the integers leave too many to be gathered, those records' integers are replaced, until the search ends, by
//    a key word's offset in its bounds: the coordinates in the node's axis order, then the id. Words before it are
//    decided. Each round divides a bracket by at least 64: a word takes at most 3 rounds and 11 further ones, whatever
//    the distribution; one that all share takes none.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/base/wide.hpp"
#include "common/partition/comm.hpp"
#include "common/partition/key.hpp"
#include "common/partition/load.hpp"
#include "common/partition/partition.hpp"
#include "common/partition/records.hpp"

namespace rcb::partition {

// [words - 1] is the id; unused words are 0.
using KeyWords = std::array<std::uint64_t, geometry::kDimsMax + 1>;

inline constexpr std::size_t kMessageBytesMax = 32 * 1024;
inline constexpr std::size_t kMessageWordsMax = kMessageBytesMax / sizeof(std::uint64_t);

// Comm::all_min in messages of that size; returns their number. Collective.
std::uint64_t all_min_in_messages(Comm& comm, std::span<std::uint64_t> values);

struct Question {
  // Asked
  bool search = true;  // false: nothing goes right
  AxisOrder axes{0, 1, 2};
  QBounds bounds;           // of the records' integers, all ranks
  std::uint64_t count = 0;  // records
  // Particles without a record, known to go left.
  std::uint64_t below = 0;
  u128 weight_below = 0;
  // without weights: the key of this rank (from 0) among `below` and the records
  std::uint64_t rank = 0;
  // with weights: left takes the prefix nearest to weight * left_size / size; `weight` is that of all, records or not
  u128 weight = 0;
  u128 left_size = 0;
  u128 size = 1;
  // Left may have so many particles (so much weight) more or less. 0: exact.
  u128 slack = 0;

  // Answered
  bool failed = false;  // particles without a record would have to be asked; the rest is unspecified
  bool right_empty = false;
  KeyWords key{};  // smallest key of the right side
  // The least and the greatest key that the answer rests on, where some particles have no record.
  KeyWords witness{};
  KeyWords reach{};
  std::uint64_t left_count = 0;  // without weights; `below` among them
  u128 left_weight = 0;          // with weights
};

// With weights: left takes at least the particle with which the prefix reaches this.
u128 threshold_of(const Question& ask);

class Selector {
 public:
  // axes: how many coordinate words a key has; 0: keys are ids alone. scale: null without weights.
  Selector(Comm& comm, const particles::ParticleView& particles, const AxisMaps& maps, int axes,
           const ExactScale* scale, const SearchLimits& limits)
      : comm_(comm),
        particles_(particles),
        maps_(maps),
        axes_(static_cast<std::size_t>(axes)),
        words_(axes_ + 1),
        scale_(scale),
        limits_(limits),
        cell_words_(scale == nullptr ? 1 : 4) {}

  // Collective.
  //   spans  [nodes * chunks], each node's records; on return middle == upper, where the right side begins
  void select(std::span<Question> nodes, std::span<Span> spans);

  std::uint64_t rounds() const { return rounds_; }
  std::uint64_t reductions() const { return reductions_; }

 private:
  enum class Phase : std::uint8_t { done, count, rekey, gather, neighbour };

  // The search of one node.
  struct State {
    Phase phase = Phase::done;
    bool single = false;  // the cut axis' integers of all keyed records were `single_value`
    std::int32_t single_value = 0;
    bool keyed = false;  // the integers stand for a key word: (its value - base) >> shift
    std::size_t word = 0;
    std::size_t words = 1;  // of the key that the integers stand for, from `word` on
    unsigned shift = 0;
    std::uint64_t base = 0;
    int rounds = 0;  // since the integers have stood for this word
    // The bracket of the open records' integers.
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
  struct Cell {
    std::uint64_t count = 0;
    u128 weight = 0;
  };
  // Looks for the key next to a bound among all of a node's particles (weights only).
  struct Neighbour {
    std::size_t node = 0;
    bool heavy_before = false;  // first step back to the last particle before the bound that has weight
    bool from_start = false;    // no bound: the node's first key
    KeyWords bound{};
  };

  void start(std::size_t node);
  std::uint64_t gather_share() const;
  bool any(Phase phase) const;
  std::vector<std::size_t> in_phase(Phase phase) const;
  void settle(std::size_t node, std::uint64_t before);
  // A round sums its histograms over ranks in messages of bounded size, group by group.
  void count_round();
  void count_node(std::size_t node, unsigned shift, std::size_t bins, std::size_t at);
  void take_count(std::size_t node, unsigned shift, std::size_t bins, std::size_t at);
  bool take_near(std::size_t node, unsigned shift, std::size_t bin, const Cell& cell);
  void narrow(std::size_t node, std::int32_t lo, std::int32_t hi, bool few);
  void rekey();
  // Of each word from the node's own on: the least among the open records, and the complement of the greatest. Local.
  void measure_words(std::size_t node, std::span<std::uint64_t> bounds) const;
  // The values of a word that integers tell: these many from the first on, a step being 2^zeros of the integers.
  struct Steps {
    std::size_t axis;
    unsigned zeros;
    std::uint64_t first;
    std::uint64_t count;
  };
  Steps steps_of(std::size_t node, std::size_t word) const;
  static void write_both(Span& span, std::size_t axis, const Steps& one, const Steps& other);
  void write_words(std::size_t node);
  void restore(std::size_t node);
  void sum_message();
  void enter(std::size_t node, std::uint64_t lo, std::uint64_t hi);
  Cell cell(std::size_t at, std::size_t bin) const;
  void add_weight(std::size_t at, u128 weight);
  // The bin that holds the wanted key; what lies before it is added to below.
  std::size_t crossing(std::size_t node, std::size_t bins, std::size_t at, Cell& found);

  void gather_candidates();
  void gather_group(std::span<const std::size_t> group);
  void pick(std::span<const Candidate> candidates);
  void pick_weighted(std::span<const Candidate> candidates);
  void look_beside(const Neighbour& wanted);
  void find_neighbours();
  // The keys nearest to each bound, after it or (backward) before it with weight > 0; false where there is none.
  std::vector<std::uint8_t> nearest(std::span<const Neighbour> wanted, bool backward, std::vector<KeyWords>& keys);
  // Divides the open records by the key found; all of them where it need not lie among the open ones.
  void divide(std::size_t node);

  bool weighted() const { return scale_ != nullptr; }
  std::size_t axis_of(std::size_t node) const {
    return axes_ == 0 ? 0 : static_cast<std::size_t>(nodes_[node].axes[0]);
  }
  std::span<Span> spans_of(std::size_t node) const { return spans_.subspan(node * chunks_, chunks_); }
  // Of a key word the integers tell as much as the coordinate: they may stand for it.
  bool told(std::size_t node, std::size_t word) const {
    return word < axes_ && maps_[static_cast<std::size_t>(nodes_[node].axes[word])].exact();
  }
  // The trailing zero bits of those integers; 0 where they don't.
  unsigned zeros_of(std::size_t node, std::size_t word) const {
    return told(node, word) ? maps_[static_cast<std::size_t>(nodes_[node].axes[word])].zeros() : 0;
  }
  std::uint64_t word_of(std::size_t node, std::size_t word, std::size_t particle) const;
  KeyWords key_words(std::size_t node, std::size_t particle) const;
  std::size_t record_words() const { return words_ + 1 + (weighted() ? 2 : 0); }

  Comm& comm_;
  const particles::ParticleView& particles_;
  const AxisMaps& maps_;
  std::size_t axes_;
  std::size_t words_;
  const ExactScale* scale_;
  const SearchLimits& limits_;
  std::size_t cell_words_;  // of a histogram's cell: a count, or a count and three limbs of weight

  std::span<Question> nodes_;
  std::span<Span> spans_;
  std::size_t chunks_ = 1;
  std::vector<State> states_;
  std::vector<Neighbour> neighbours_;
  Buffer<std::uint64_t> message_;
  std::size_t per_word_ = 1;  // counts packed into a word of the message
  Buffer<std::uint32_t> bins_;

  std::uint64_t rounds_ = 0;
  std::uint64_t reductions_ = 0;
};

}  // namespace rcb::partition
