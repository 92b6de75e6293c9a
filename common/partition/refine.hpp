// Refiner: finds the exact cut tree from a guessed one (guess.hpp). A pass sends all particles down the guess
// (descent.hpp); then, level by level from the top, the few inside brackets are counted and the cuts selected among
// them (select.hpp), exactly. Where the guess was wrong (another axis is the longest, a bracket does not hold the cut)
// the node begins the next pass, with what was learnt; so do the nodes that the guess did not reach.
//
// Invariants
// 1. The tree does not depend on the sample: a cut is taken from a guess only if exact bounds gave the same axis order
//    (as far as it matters) and exact counts showed that the bracket holds the cut.
// 2. A node begins at most three passes: after a miss its bracket is four times as wide, after two it holds the cut for
//    certain. So there are at most three passes a level, and every search in a pass is bounded as the Selector's are.
// 3. Between passes label[i] >= 0 is a place of the last pass, and next_[place] says what became of it: -1 - p is
//    part p, else a node of the frontier.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/partition/descent.hpp"
#include "common/partition/guess.hpp"
#include "common/partition/select.hpp"

namespace rcb::partition {

// Points of the sample that balance its cost and its use. Local.
std::uint64_t balanced_sample(std::uint64_t count, int ranks);

class Refiner {
 public:
  // Without weights. Every rank has fewer than 2^31 particles.
  Refiner(Comm& comm, const particles::ParticleView& particles, const SplitRule& rule, const PartitionOptions& options);

  // Collective. Fills the tree's cuts and gives every particle its part.
  //   all  bounds of all ranks' particles
  void run(const Bounds& all, CutTree& tree, std::span<std::int32_t> part);

  const RefineCounts& counts() const { return counts_; }
  std::uint64_t rounds() const { return rounds_ + selector_.rounds(); }
  std::uint64_t reductions() const { return reductions_ + selector_.reductions(); }

 private:
  void pass(std::span<std::int32_t> label);
  // One level of the guess: bounds, counts, cuts, and its waiting particles go on.
  void settle_level(int depth, std::span<std::int32_t> label);
  void measure_level(std::span<const int> level);
  AxisOrder exact_axes(int node) const;
  bool order_holds(int node);
  bool bracket_holds(int node, std::uint64_t below, std::uint64_t inside);
  SelectNode question(int node) const;
  void select_level(std::vector<int> asked, int depth, std::span<std::int32_t> label);
  static void renumber(Buffer<Descent::Mover>& movers, std::span<const std::int32_t> number, int shift);
  std::size_t axis_of(const SelectNode& ask, std::size_t word) const;
  // The first word that a bracket leaves open.
  std::size_t open_word(const SelectNode& ask) const;
  std::uint64_t word_of(const Descent::Mover& mover, std::size_t axis) const {
    return axis < geometry::kDimsMax ? geometry::image(mover.at[axis])
                                     : static_cast<std::uint64_t>(particles_.id[mover.index]);
  }
  void count_and_narrow(std::span<SelectNode> questions, std::span<int> asked, std::span<const Descent::Mover> movers);
  bool narrow_again(std::span<SelectNode> questions, std::span<const Descent::Mover> movers);
  void shrink(std::span<SelectNode> questions, std::span<const std::size_t> many, std::span<const std::int32_t> slot,
              std::span<const Descent::Mover> movers);
  void choose_sides(std::span<const SelectNode> questions, std::span<const int> asked,
                    std::span<Descent::Mover> movers);
  void select_candidates(std::span<SelectNode> questions, std::span<const int> asked, std::span<Descent::Mover> movers);
  struct Probe;
  Probe probe_of(const SelectNode& ask, std::size_t bins) const;
  static void take_bin(SelectNode& ask, const Probe& probe, std::size_t word, std::span<const std::uint64_t> histogram);
  void sum_histogram();
  // The node begins the next pass; what rests below it belongs to it.
  void postpone(int node, double side_lo, double side_hi);
  void deal_sample();

  Comm& comm_;
  const particles::ParticleView& particles_;
  const SplitRule& rule_;
  const Refinement& refinement_;
  Guess guess_;
  Descent descent_;
  particles::ParticleSet chosen_;  // the candidates of a level
  particles::ParticleView chosen_view_;
  Selector selector_;
  CutTree* tree_ = nullptr;

  std::vector<SamplePoint> sample_;
  std::vector<FrontierNode> frontier_;
  std::vector<FrontierNode> next_frontier_;
  std::vector<std::int32_t> start_;              // by place of the last pass: where this pass begins, or -1 - part
  std::vector<std::int32_t> next_;               // by place of this pass
  std::vector<Buffer<Descent::Mover>> waiting_;  // in brackets, by the depth of their nodes
  Buffer<std::uint32_t> candidates_;             // the movers whose side the histogram left open
  Buffer<std::int32_t> candidate_node_;
  Buffer<std::uint64_t> histogram_;
  std::vector<std::size_t> words_;  // by question: the word that its bracket leaves open
  // By node of the guess.
  std::vector<Bounds> bounds_;
  std::vector<std::uint8_t> settled_;  // the cut is known, or it is a part
  std::vector<std::uint8_t> dead_;     // below a node that begins the next pass

  RefineCounts counts_;
  std::uint64_t rounds_ = 0;
  std::uint64_t reductions_ = 0;
};

}  // namespace rcb::partition
