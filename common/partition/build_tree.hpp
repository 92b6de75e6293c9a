// TreeBuilder: the levels of a partition. For each level: the extents of its nodes, their axis orders, the search for
// their cuts (select.hpp), and one pass that gives every particle its child and finds the children's extents.
//
// Invariants
// 1. label_[i] >= 0 is the position of particle i's node among the level's inner nodes; -1 - p: it is in part p.
// 2. A node's count (without weights) or weight (with) is known from its parent's cut, never counted again.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "common/partition/load.hpp"
#include "common/partition/partition.hpp"
#include "common/partition/select.hpp"
#include "common/partition/split_rule.hpp"

namespace rcb::partition {

class TreeBuilder {
 public:
  // The options are checked. axes: particles.dims, or 0 to cut by ids alone (weights don't count then).
  TreeBuilder(Comm& comm, const particles::ParticleView& particles, const PartitionOptions& options, int axes);

  // Collective.
  PartitionResult build();

 private:
  struct Node {
    NodeRange range;
    std::uint64_t count = 0;  // without weights
    u128 weight = 0;          // with weights
  };
  // What the labelling pass reads of a node.
  struct Branch {
    double at = 0;  // infinite where nothing goes right
    const double* x = nullptr;
    std::int32_t left = 0;
    std::int32_t right = 0;
    const Cut* cut = nullptr;
  };

  void measure_all();
  // Whether the tree is refined from a guess; else it is searched level by level.
  bool refinable() const;
  void refine();
  void ask(const Node& node, const Bounds& bounds, SelectNode& out) const;
  // Makes the level's cuts from the answers, and the next level's nodes.
  void split(std::span<const SelectNode> answers);
  void label_all();
  template <int kAxes>
  void label_and_measure();
  void label_by_id();
  bool goes_right(const Branch& branch, std::size_t particle) const;
  void reduce_bounds();

  Comm& comm_;
  const particles::ParticleView& particles_;
  const PartitionOptions& options_;
  int axes_;
  SplitRule rule_;
  std::optional<ExactScale> scale_;  // of the weights, if they count
  std::size_t local_count_max_ = 0;  // of any rank

  PartitionResult result_;
  std::vector<Node> level_;
  std::vector<Node> next_;
  std::vector<Branch> branches_;
  std::vector<Bounds> bounds_;  // of level_, later of next_
};

}  // namespace rcb::partition
