// TreeBuilder: the levels of a partition. For each level: the axis orders of its nodes, the search for their cuts,
// which divides their records (select.hpp), and one pass over the children's records for their bounds.
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
    QBounds bounds;           // all ranks
    AxisOrder axes{0, 1, 2};
  };

  void measure_all();
  void choose_maps(std::span<const std::uint64_t> samples);
  std::vector<std::uint64_t> sample_maps() const;
  // Collective (one reduction at most).
  void make_records();
  void order_axes();
  Extents extents_of(const QBounds& bounds) const;
  // The exact extents of these nodes. Collective (one reduction).
  std::vector<Point> measure(std::span<const std::size_t> nodes);
  Question question(const Node& node) const;
  u128 slack_of(const Node& node) const;
  // Makes the level's cuts from the answers, and the next level's nodes.
  void split(std::span<const Question> answers);
  void take_child(const Node& child, bool right, std::size_t parent);
  void reduce_bounds();

  Comm& comm_;
  const particles::ParticleView& particles_;
  const PartitionOptions& options_;
  int axes_;
  std::size_t q_axes_;  // coordinates in a record
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
};

}  // namespace rcb::partition
