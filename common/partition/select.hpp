// Selector: exact distributed selection, for all nodes of a tree level together. Each node asks for the smallest key
// of its right side; the answer is the same bits on every rank, whatever particles lie where.
//
// Invariants
// 1. A key is words: the coordinates' images in the node's axis order, then the id. A node's words before the
//    current one are decided (least == greatest), the current one has a bracket, the later ones have bounds.
// 2. Every particle of a node below its bracket is counted in `below` (and `weight_below`); the wanted key is inside.
// 3. A histogram round divides a bracket by at least 256, so a word of 64 bits takes at most 8 rounds; a word of one
//    value takes none.
// 4. After the first round only the particles inside a bracket (the stash) are looked at.
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

namespace rcb::partition {

// [words - 1] is the id; unused words are 0.
using KeyWords = std::array<std::uint64_t, geometry::kDimsMax + 1>;

inline constexpr std::size_t kMessageBytesMax = 32 * 1024;
inline constexpr std::size_t kMessageWordsMax = kMessageBytesMax / sizeof(std::uint64_t);

struct SelectNode {
  // Asked
  bool empty = false;  // no particle in it
  AxisOrder axes{0, 1, 2};
  KeyWords lo{};  // bounds of the particles' words: the brackets to begin with
  KeyWords hi{};
  // without weights: the key of this rank (from 0) among `count`
  std::uint64_t count = 0;
  std::uint64_t rank = 0;
  // with weights: left takes the prefix nearest to weight * left_size / size
  u128 weight = 0;
  u128 left_size = 0;
  u128 size = 1;

  // Answered
  bool right_empty = false;
  KeyWords key{};        // smallest key of the right side
  u128 left_weight = 0;  // with weights
};

class Selector {
 public:
  // axes: how many coordinate words a key has; 0: keys are ids alone. scale: null without weights.
  Selector(Comm& comm, const particles::ParticleView& particles, int axes, const ExactScale* scale)
      : comm_(comm),
        particles_(particles),
        axes_(static_cast<std::size_t>(axes)),
        words_(axes_ + 1),
        scale_(scale),
        cell_words_(scale == nullptr ? 1 : 4) {}

  // Collective.
  //   label  [particles.count]; label[i] in [0, nodes.size()) names particle i's node, others are in none
  void select(std::span<SelectNode> nodes, std::span<const std::int32_t> label);

  std::uint64_t rounds() const { return rounds_; }
  std::uint64_t reductions() const { return reductions_; }

 private:
  enum class Phase : std::uint8_t { refine, next_word, gather, neighbour, done };

  // The search of one node.
  struct State {
    Phase phase = Phase::done;
    std::size_t word = 0;  // the one whose bracket is refined
    KeyWords lo{};
    KeyWords hi{};
    std::uint64_t below = 0;
    std::uint64_t inside = 0;
    u128 weight_below = 0;
    u128 threshold = 0;    // with weights: the shortest prefix of at least this weight ends in the bracket
    std::size_t slot = 0;  // in the histogram
  };
  // What a pass over particles reads of a node; an idle node has a bracket that holds nothing.
  struct Probe {
    const double* x = nullptr;  // null: the id
    std::uint64_t lo = ~std::uint64_t{0};
    std::uint64_t span = 0;
    unsigned shift = 0;
    std::size_t cells = 0;  // where its histogram starts
  };
  struct Candidate {
    std::size_t node;
    KeyWords key;
    u128 weight;
  };
  // Looks for the key next to a bound among all of a node's particles (weights only).
  struct Neighbour {
    std::size_t node = 0;
    bool heavy_before = false;  // first step back to the last particle before the bound that has weight
    bool from_start = false;    // no bound: the node's first key
    KeyWords bound{};
  };

  void select_batch(std::span<SelectNode> nodes, std::int32_t first_label, std::span<const std::int32_t> label);
  // What is known without a look at particles.
  void start(std::size_t node);
  // Passes over all particles of the batch.
  void count_all(std::span<const std::int32_t> label);
  void stash_all(std::span<const std::int32_t> label);
  // A pass over the stash: drops what left its bracket, counts the rest.
  void count_stash();
  // Nodes whose bracket is one value: bounds of the later words among the equals.
  void enter_next_words();
  void plan_round();
  void reduce_histogram();
  void narrow(std::size_t node);
  void settle(std::size_t node);
  void gather_candidates();
  void gather_group(std::span<const std::size_t> group, std::span<const std::size_t> starts,
                    std::span<const std::size_t> order);
  void pick(std::span<const Candidate> candidates);
  void pick_weighted(std::span<const Candidate> candidates);
  void find_neighbours(std::span<const std::int32_t> label);
  // The keys nearest to each bound, after it or (backward) before it with weight > 0; false where there is none.
  std::vector<std::uint8_t> nearest(std::span<const Neighbour> wanted, bool backward,
                                    std::span<const std::int32_t> label, std::vector<KeyWords>& keys);

  bool any(Phase phase) const;
  bool weighted() const { return scale_ != nullptr; }
  void set_probes(bool refining_only);
  std::uint64_t word_of(std::size_t node, std::size_t word, std::size_t particle) const;
  KeyWords key_words(std::size_t node, std::size_t particle) const;
  void add(std::size_t cell, std::size_t particle);
  std::size_t record_words() const { return words_ + 1 + (weighted() ? 2 : 0); }
  void count_reductions(std::size_t words) { reductions_ += (words + kMessageWordsMax - 1) / kMessageWordsMax; }

  Comm& comm_;
  const particles::ParticleView& particles_;
  std::size_t axes_;
  std::size_t words_;
  const ExactScale* scale_;
  std::size_t cell_words_;  // of a histogram's cell: a count, or a count and three limbs of weight

  std::span<SelectNode> nodes_;
  std::int32_t first_label_ = 0;
  std::vector<State> states_;
  std::vector<Probe> probes_;
  std::vector<std::size_t> refining_;
  std::size_t bins_ = 256;
  Buffer<std::uint64_t> histogram_;
  std::vector<Neighbour> neighbours_;
  // The stash, in step.
  Buffer<std::uint64_t> stash_word_;
  Buffer<std::int32_t> stash_node_;
  Buffer<std::size_t> stash_index_;

  std::uint64_t rounds_ = 0;
  std::uint64_t reductions_ = 0;
};

}  // namespace rcb::partition
