// Room `search`: the exact cuts of a tree, level by level. Entry: TreeSearch (tree_search.hpp). No optimisation may
// change the tree: tests/common/partition compares it with brute force.
//
// Node: a node of the tree before its cut is known; and Wholes, what its wholes tell of the cut.
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

// Of some buckets.
geometry::Box box_of(std::span<const Bucket> buckets, std::span<const std::int32_t> some);
Load load_of(std::span<const Bucket> buckets, std::span<const std::int32_t> some);

// The wholes of a node on its cut axis. All is local. A load is a count or, with weights, a weight. `wanted`: the
// prefix of keys that reaches this load ends with the wanted key.
class Wholes {
 public:
  Wholes(std::span<const Bucket> buckets, const Node& node, bool weighted)
      : buckets_(buckets), node_(node), weighted_(weighted) {}

  Interval interval_of(std::int32_t bucket) const;
  bool meets(const Interval& interval) const;
  // Of those that lie in this region.
  Load load_in(const Interval& region) const;
  // The first integer of any above this one; kTop: there is none.
  std::int32_t first_above(std::int32_t integer) const;

  // Between the wholes that are meant for the left and those for the right. Empty if these don't lie apart, since the
  // cut lies across another axis than expected.
  Interval gap() const;
  // Where there is no gap: between the wholes that end below the likely key and those that begin above it. The key is
  // guessed by the loads: each whole's is taken to lie in the middle of its span, and half of the points' below the
  // key. There must be a whole.
  Interval likely(u128 wanted) const;
  // After a miss: an interval that is certain to hold the wanted key, which lies in this region. Only the wholes and
  // the points in the region are counted: the prefix of theirs that reaches `wanted` > 0 ends with the key.
  //   loose  the load of those points, wherever in the region they are
  Interval certain(const Interval& region, u128 loose, u128 wanted) const;

 private:
  u128 load(std::int32_t bucket) const {
    const Load& own = buckets_[at(bucket)].load;
    return weighted_ ? own.weight : u128{own.count};
  }
  std::vector<std::int32_t> in(const Interval& region) const;

  std::span<const Bucket> buckets_;
  const Node& node_;
  bool weighted_;
};

}  // namespace rcb::partition
