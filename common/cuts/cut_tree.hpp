// CutTree: P parts as a binary tree of cuts. It is small, replicated on every rank and in clients, and it alone decides
// which part owns a position. Its bytes and their hash are a promise to clients (PROTOCOL.md): a change here changes
// every partition's hash.
//
// Invariants
// 1. Nodes are numbered in preorder over the inner nodes: a node of k >= 2 parts [a, b) gives the lower ceil(k/2) to
//    its left child; left child = node + 1, right child = node + ceil(k/2), when they are inner. A child of one part is
//    a leaf. There are P - 1 inner nodes.
// 2. A particle goes right exactly if its key (key.hpp, with the cut's axes) is not less than the cut's key; a cut
//    without a key (empty right side) sends everything left.
// 3. hash() depends on the tree alone: the same bits on any machine, rank count and build.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/cuts/key.hpp"
#include "common/cuts/method.hpp"
#include "common/geometry/box.hpp"

namespace rcb::cuts {

struct Cut {
  AxisOrder axes{0, 1, 2};  // axes[0] is the cut axis
  bool right_empty = false;
  Key key;  // smallest key of the right side; unused if right_empty

  bool operator==(const Cut&) const = default;
};

// A node's range of parts, and where its children lie in preorder.
struct NodeRange {
  int node = 0;
  int first = 0;  // parts [first, last)
  int last = 1;

  int parts() const { return last - first; }
  bool leaf() const { return parts() == 1; }
  int middle() const { return first + (parts() + 1) / 2; }
  NodeRange left() const { return {node + 1, first, middle()}; }
  NodeRange right() const { return {node + (parts() + 1) / 2, middle(), last}; }
};

class CutTree {
 public:
  int dims = 3;
  Method method = Method::rcb;
  int parts = 1;
  std::vector<double> part_sizes;  // relative; empty, or all the same: equal parts
  std::vector<Cut> cuts;           // parts - 1, in preorder

  NodeRange root() const { return {0, 0, parts}; }
  // The cut of the inner node with exactly the parts [first, last); null if there is none. Local, O(depth).
  const Cut* cut_of(int first, int last) const;

  // The part that owns this position and id. Local, O(depth).
  int part_of(const Point& position, Id id) const;
  // Sets out[i] to the part of particle i. Local.
  void classify(const particles::ParticleView& particles, std::span<std::int32_t> out) const;
  // Every part that owns this position for some id, ascending. Local.
  std::vector<int> candidates(const Point& position) const;
  // The boxes that the cuts leave for the parts [first, last): infinite where unbounded; empty() on the right side of a
  // cut without a key. Local.
  std::vector<geometry::Box> regions(int first, int last) const;
  // XXH3-64 (seed 0) of encode(). Local.
  std::uint64_t hash() const;

  // The canonical bytes (specified in docs/hash.md), to hash: equal part sizes are left out, -0.0 is written as 0.0.
  std::vector<std::byte> encode() const;
};

// Inner nodes whose cut axis differs from that of the old tree's node with the same parts; nodes without a
// counterpart don't count. Local.
int axes_flipped(const CutTree& old_tree, const CutTree& new_tree);

}  // namespace rcb::cuts
