// Room `search`: the exact cuts of a tree, level by level. Entry: TreeSearch (tree_search.hpp). No optimisation may
// change the tree: tests/common/partition compares it with brute force.
//
// Node: a node of the tree before its cut is known.
#pragma once

#include <cstdint>
#include <vector>

#include "common/partition/buckets/buckets.hpp"
#include "common/partition/search/cut_search.hpp"

namespace rcb::partition {

// Its particles are those of its wholes, which are buckets of which no particle was looked at, and its points.
struct Node {
  NodeRange range;
  AxisOrder axes{0, 1, 2};
  Load load;                         // the root's is complete; below it, count without weights, weight with
  std::vector<std::int32_t> wholes;  // buckets
  std::vector<Segment> segments;     // of the points, this rank's
  PointSet points;                   // without its `segments`

  bool empty() const { return wholes.empty() && points.bounds.empty(); }
};

// The bounding box of some buckets.
inline geometry::Box box_of(std::span<const Bucket> buckets, std::span<const std::int32_t> some) {
  geometry::Box box;
  for (const std::int32_t b : some) box.extend(buckets[static_cast<std::size_t>(b)].box);
  return box;
}

}  // namespace rcb::partition
