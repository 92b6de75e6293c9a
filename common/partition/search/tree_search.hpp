// TreeSearch: makes a tree level by level. It begins with buckets, most of which stay wholes: a node treats a whole by
// its load and its box. On a node's cut axis the key is looked for in the gap between the wholes that are expected on
// the left and those expected on the right. Where these overlap, since the cut lies across another axis than expected,
// it is looked for where the loads of the wholes put it. Wholes that meet this interval are opened first: their
// particles become points of the node. If the key isn't there, the loads tell an interval in which it is for certain,
// and what meets that is opened. So a bad expectation costs time, and no answer.
//
// Invariants
// 1. On the cut axis the integers of a whole all lie below that of the cut's key, or all above it.
// 2. A node's load is known from its parent's cut and never counted again; that of its points is what its wholes leave.
// 3. Axis orders are exact (node_axes.hpp).
#pragma once

#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "common/partition/rules/split_rule.hpp"
#include "common/partition/search/node.hpp"

namespace rcb::partition {

// Makes the points of these buckets, and returns what it learns of the maps. Local.
using MakePoints = std::function<Lossless(std::span<const std::int32_t> buckets)>;

// What a search begins with.
struct SearchStart {
  std::span<Bucket> buckets;
  AxisMaps& maps;
  const std::optional<ExactScale>& scale;  // of the weights, if they count
  PointStore& points;                      // must outlive the result
  MakePoints make_points;
  // Of how many particles points may be made later: with more, a search among all takes less time.
  std::uint64_t opened_max = 0;
};

struct TreeFound {
  CutTree tree;
  std::vector<std::uint64_t> counts;         // of each part, all ranks; empty where weights count
  std::vector<std::int32_t> part_of_bucket;  // of those that stayed wholes; -1: it was opened
  std::vector<PointsOfPart> points;          // of the others, this rank's
  std::uint64_t opened = 0;                  // particles of buckets that had no points before
};

class TreeSearch {
 public:
  // `options` must be valid.
  TreeSearch(comm::Comm& comm, const particles::ParticleView& particles, const PartitionOptions& options,
             const SearchStart& start, SearchCost& cost);

  // nullopt if go_on, which is called before each level, said no, or if too many points would be made. Collective.
  std::optional<TreeFound> find(const comm::GoOn& go_on);

 private:
  // A node whose cut isn't found yet. Its wholes that meet `to_open` on the cut axis are to be opened.
  struct Pending {
    std::size_t node;
    Interval to_open;
  };
  u128 load_wanted(const CutRequest& wanted) const;
  u128 amount(const Load& load) const { return start_.scale ? load.weight : u128{load.count}; }
  Wholes wholes_of(const Node& node) const { return {start_.buckets, node, start_.scale.has_value()}; }

  // A level's requests, and where their keys are looked for first. Local.
  std::vector<Pending> begin_level();
  CutRequest request_of(const Node& node) const;
  u128 slack_of(const Node& node) const;
  // Opens those wholes of nodes. False if too many points would be made. Collective (one minimum at most).
  bool open(std::span<const Pending> pending);
  // The nodes that must be searched again. Local.
  std::vector<Pending> check(std::span<const Pending> pending, std::span<const CutFound> found);
  // Finds the cuts of the level. False if too many points would be made. Collective.
  bool search_level();
  // Makes them, and the next level's nodes. Collective (a minimum).
  void cut_level();
  Node child(const Node& parent, const CutFound& found, bool right);
  void finish_part(const Node& leaf);
  void reduce_bounds(std::span<Node> nodes);
  void cut_empty(const NodeRange& range);

  comm::Comm& comm_;
  const particles::ParticleView& particles_;
  const PartitionOptions& options_;
  const SearchStart& start_;
  SearchCost& cost_;
  SplitRule rule_;
  CutSearch search_;
  double level_tolerance_;
  std::vector<Node> level_;
  std::vector<CutRequest> wanted_;  // of the level
  std::vector<CutFound> found_;
  TreeFound result_;
};

// The tree that these options ask for, its cuts not found yet. Local.
CutTree uncut_tree(const PartitionOptions& options, int dims);

}  // namespace rcb::partition
