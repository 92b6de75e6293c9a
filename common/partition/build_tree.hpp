// TreeBuilder: the levels of a partition. For each level: the axis orders of its nodes, the search for their cuts,
// which divides their records (select.hpp), and one pass over the children's records for their bounds.
//
// It may begin below the root, at the nodes of a tree that are to be cut anew, and it may search among few particles
// while the others are known to stay (settled.hpp); a node for which that doesn't hold has failed.
//
// Invariants
// 1. The records of a level's nodes, in order, are one span a chunk each; a part's records never move again.
// 2. A node's count (without weights) or weight (with) is known from its parent's cut, never counted again.
// 3. Axis orders are exact: bounds of the records' integers decide where they can, the particles' coordinates
// elsewhere.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "common/partition/load.hpp"
#include "common/partition/partition.hpp"
#include "common/partition/records.hpp"
#include "common/partition/select.hpp"
#include "common/partition/settled.hpp"
#include "common/partition/split_rule.hpp"

namespace rcb::partition {

// Where to begin, if not with all particles at the root.
struct Start {
  std::vector<NodeRange> roots;      // inner nodes, apart from each other, ascending
  std::vector<std::size_t> ends;     // [roots]: the particles stand root after root; those of root r end here
  const CutTree* tree = nullptr;     // its other cuts stay
  const SplitRule* rule = nullptr;   // decided with all particles; null: only where the one root is the tree's
  std::optional<ExactScale> scale;   // of the weights, if they count
  const Settled* settled = nullptr;  // beside the particles; null: none
  std::uint64_t failed_max = 0;      // with more particles in nodes that fail, the build ends at once
};

class TreeBuilder {
 public:
  // The options are checked. axes: particles.dims, or 0 to cut by ids alone (weights don't count then).
  TreeBuilder(Comm& comm, const particles::ParticleView& particles, const PartitionOptions& options, int axes);
  // `start` must outlive this.
  TreeBuilder(Comm& comm, const particles::ParticleView& particles, const PartitionOptions& options,
              const Start& start);

  // Counts are known of the roots' parts alone. go_on: asked before each level. Collective.
  PartitionResult build(const GoOn& go_on = {});

  // Nodes that can't be cut without their settled particles: the cuts in them are unspecified, and their particles are
  // said to be in their first part.
  const std::vector<NodeRange>& failed() const { return failed_; }
  // The build ended for too many of them, or was told to: nothing of its result counts.
  bool abandoned() const { return stopped_ || (start_ != nullptr && failed_count_ > start_->failed_max); }
  const SplitRule& rule() const { return rule_; }

 private:
  struct Node {
    NodeRange range;
    // Of the records, all ranks.
    std::uint64_t count = 0;  // without weights
    u128 weight = 0;          // with weights
    QBounds bounds;
    AxisOrder axes{0, 1, 2};
  };

  // What all particles decide: bounds, maps, the roots. Collective.
  void measure_all();
  void weigh_roots();
  std::size_t root_begin(std::size_t root) const { return root == 0 ? 0 : root_end(root - 1); }
  std::size_t root_end(std::size_t root) const { return start_ == nullptr ? particles_.count : start_->ends[root]; }
  void choose_maps(std::span<const std::uint64_t> samples);
  std::vector<std::size_t> sampled_slots() const;
  std::vector<std::uint64_t> sample_maps() const;
  // Collective (one reduction at most).
  void make_records();
  // The spans of the roots' records; their bounds where they aren't those of all. Collective.
  void lay_out_roots();
  void order_axes();
  Extents extents_of(const Node& node) const;
  // The exact extents of these nodes. Collective (one reduction).
  std::vector<Point> measure(std::span<const std::size_t> nodes);
  Question question(const Node& node) const;
  // What the settled particles add to a question, and whether the records can answer it.
  void add_settled(const NodeRange& range, Question& ask) const;
  // Whether the settled particles stay where they are under the answer.
  bool stands(const NodeRange& range, const Question& answer) const;
  void give_up(std::size_t node);
  u128 slack_of(const Node& node) const;
  // Makes the level's cuts from the answers, and the next level's nodes.
  void split(std::span<const Question> answers);
  void take_child(const Node& child, bool right, std::size_t parent);
  // Every rank's bounds of these nodes. Collective.
  void reduce_bounds(std::span<Node> nodes);

  Comm& comm_;
  particles::ParticleView particles_;
  const PartitionOptions& options_;
  int axes_;
  std::size_t q_axes_;  // coordinates in a record
  const Start* start_ = nullptr;
  bool stopped_ = false;
  const Settled* settled_ = nullptr;
  SplitRule rule_;
  double level_tolerance_ = 0;
  std::optional<ExactScale> scale_;  // of the weights, if they count
  Point lo_{};                       // of all particles
  Point hi_{};
  Id id_lo_ = 0;
  Id id_hi_ = 0;
  AxisMaps maps_;
  std::array<std::uint64_t, geometry::kDimsMax> told_{};  // 1: of a sample the integers tell the coordinates
  Records records_;

  PartitionResult result_;
  std::vector<Node> level_;
  std::vector<Node> next_;
  std::vector<Span> spans_;  // [level_ * chunks]
  std::vector<Span> next_spans_;
  std::vector<Record*> starts_;    // of chunks
  std::vector<std::size_t> ends_;  // [chunk * parts + part]
  std::vector<NodeRange> failed_;
  std::uint64_t failed_count_ = 0;  // particles in them
};

}  // namespace rcb::partition
