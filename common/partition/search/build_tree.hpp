// TreeBuilder: makes a tree level by level. For each level it orders the axes of the nodes, searches their cuts, which
// also divides their quantised points (select.hpp), and passes once over those of each span that was divided, for the
// children's bounds (if they don't all lie in one place).
//
// It may search among boundary particles alone while interior particles are expected to stay (interior.hpp). A node
// whose interior particles would not stay has failed; another build may begin at such nodes.
//
// Invariants
// 1. A node has one or more spans of quantised points in each chunk that has any. Those of a finished part never move
//    again.
// 2. A node's count (without weights) or weight (with) is known from its parent's cut and never counted again.
// 3. Axis orders are exact: where the bounds of the quantised points leave the order open, the coordinates decide.
#pragma once

#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

#include "common/base/index.hpp"
#include "common/partition/balance/load.hpp"
#include "common/partition/search/buckets.hpp"
#include "common/partition/search/interior.hpp"
#include "common/partition/search/part_writer.hpp"
#include "common/partition/search/quantised_points.hpp"
#include "common/partition/search/request.hpp"
#include "common/partition/search/select.hpp"
#include "common/partition/search/split_rule.hpp"

namespace rcb::partition {

// The tree that these options ask for, its cuts not found yet. Local.
CutTree uncut_tree(const PartitionOptions& options, int dims);

// [parts]: which of the roots has a part, or Roots::kNone. Local.
std::vector<std::int32_t> roots_of_parts(std::span<const NodeRange> roots, int parts);

// Where to begin, if not with all particles at the root.
struct Start {
  std::vector<NodeRange> roots;  // inner nodes, none below another, ascending; empty: that of the whole tree
  // Of each particle so far; those of parts in no root are left out. The parts found are written here instead of the
  // result, whose `counts` are set for parts below the roots only. Empty: there are none.
  std::span<std::int32_t> part;
  const CutTree* tree = nullptr;         // its cuts outside of the roots are kept
  const SplitRule* rule = nullptr;       // made from all particles; may be null only if the one root is the tree's
  std::optional<ExactScale> scale;       // of the weights, if they count
  const Interior* interior = nullptr;    // particles that are not searched; null: none. From the tree's root alone
  const Splitters* splitters = nullptr;  // if there is an interior: where the cuts are expected, for buckets
  // The build is abandoned once nodes that could not be cut hold more particles.
  std::uint64_t failed_max = std::numeric_limits<std::uint64_t>::max();
  // To begin with buckets; no particle may have a weight. A sample of all particles on rank 0, empty elsewhere; what
  // was sampled must outlive the builder.
  SortedSample sample;
  std::uint64_t stride = 0;  // one particle of so many was sampled; 0: there is no sample
};

class TreeBuilder {
 public:
  // `options` must be valid.
  TreeBuilder(comm::Comm& comm, const particles::ParticleView& particles, const PartitionOptions& options,
              Start start = {});

  // nullopt if failed nodes hold too many particles or go_on, which is called before each level, said no. Collective.
  std::optional<PartitionResult> build(const comm::GoOn& go_on = {});

  // Nodes left uncut, ascending, since they can't be cut without their interior particles. The cuts in them are
  // unspecified, and their particles are all reported in the node's first part.
  const std::vector<NodeRange>& uncut() const { return uncut_; }
  const SplitRule& rule() const { return rule_; }

 private:
  struct Node : NodePoints {
    NodeRange range;
    std::size_t spans_first = 0;  // its spans: [spans_first, spans_last) of the level's
    std::size_t spans_last = 0;
    std::size_t number = 0;       // among the splitters, if the root has number 0
    SortedSample::Range sampled;  // its sampled particles, on rank 0
  };

  // Sets box_ and greatest_weight_. Collective (what own_box() costs, and one reduction where the box of the boundary
  // particles isn't known).
  void find_box();
  // The box of this rank's particles. Sorts them into buckets, if it is known where cuts are expected. Collective with
  // a sample (at most three gathers).
  geometry::Box own_box();
  bool sampled() const { return start_.stride > 0; }
  bool bucketed() const { return splitters_.has_value(); }
  // Measures all particles: bounds, maps, the roots' counts. Collective.
  void measure_all();
  void weigh_roots();
  // Sets roots_ and counts this rank's particles of each.
  std::vector<std::uint64_t> find_roots();
  void choose_maps(std::span<const std::uint64_t> samples);
  std::vector<std::size_t> sampled_slots() const;
  std::vector<std::uint64_t> sample_maps() const;
  // Collective (one reduction at most).
  void quantise();
  // The roots' spans and, if there are several, each one's bounds. Collective.
  void lay_out_roots();
  void order_axes();
  // True if integers alone tell that all quantised points lie in one place.
  bool one_lossless_place(const QBounds& bounds) const;
  Extents extents_of(const Node& node) const;
  // The exact extents of these nodes; notes which are coincident. Collective (one reduction).
  std::vector<Point> measure(std::span<const std::size_t> nodes);
  CutRequest request_of(const Node& node);
  // Adds the interior particles to a request, and marks it where the quantised points alone can't answer it.
  void add_interior(const NodeRange& range, CutRequest& wanted) const;
  // Of the node's parts.
  std::uint64_t interior_count(const NodeRange& range) const {
    return interior_ == nullptr ? 0 : interior_->count(range.first, range.last);
  }
  geometry::Box interior_box(const NodeRange& range) const {
    return interior_ == nullptr ? geometry::Box{} : interior_->box(range.first, range.last);
  }
  // True if all interior particles stay on their side of the cut found.
  bool cut_still_valid(const NodeRange& range, const CutRequest& wanted, const CutFound& found) const;
  void leave_uncut(std::size_t node);
  u128 slack_of(const Node& node) const;
  // Makes the level's cuts, and the next level's nodes.
  void split(std::span<const CutRequest> wanted, std::span<const CutFound> found);
  // Takes nodes without any particle out of the next level: their cuts, and those below, follow from the rule alone.
  // With many more parts than particles most nodes are such.
  void settle_empty();
  void cut_empty(const NodeRange& range);
  void take_child(Node child, bool right, std::size_t parent);
  std::span<Span> spans_of(const Node& node) {
    return std::span(spans_).subspan(node.spans_first, node.spans_last - node.spans_first);
  }
  // Where a node's axis isn't that of the sample's cut: finds where its cut is expected. Collective (at most one
  // gather).
  void expect_other_axes();
  // Where the key's first integer is expected, if that is known.
  std::optional<std::array<std::int32_t, 2>> expected_in(const Node& node) const;
  // Turns this rank's bounds of these nodes into those of all ranks. Collective.
  void reduce_bounds(std::span<Node> nodes);

  comm::Comm& comm_;
  particles::ParticleView particles_;
  const PartitionOptions& options_;
  int axes_;
  Start start_;
  std::optional<Splitters> splitters_;
  // Of each particle; empty: there are none. Those of a sample take the last quarter of the parts' memory until these
  // are written.
  std::span<std::uint8_t> bucket_;
  Buffer<std::uint8_t> own_bucket_;
  const Interior* interior_;
  SplitRule rule_;
  double level_tolerance_ = 0;
  std::optional<ExactScale> scale_;        // of the weights, if they count
  std::optional<double> greatest_weight_;  // if they count
  geometry::Box box_;  // of all particles in the roots; of the boundary particles, if there are interior ones
  AxisMaps maps_;
  std::array<std::uint64_t, geometry::kDimsMax> lossless_{};  // 1: nothing lost in the sample; see quantise()
  Roots roots_;
  std::vector<std::int32_t> root_of_;  // [parts]
  bool all_particles_ = true;          // of this rank are in a root
  QuantisedPoints points_;

  PartitionResult result_;
  std::vector<Node> level_;
  std::vector<Node> next_;
  std::vector<Span> spans_;  // of the level's nodes
  std::vector<Span> next_spans_;
  PartWriter writer_;
  std::vector<NodeRange> uncut_;
  std::uint64_t failed_count_ = 0;  // particles in nodes that could not be cut
};

}  // namespace rcb::partition
