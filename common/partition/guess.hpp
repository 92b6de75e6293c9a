// A guess of the tree below some nodes, from a sample that every rank holds: for each inner node an axis order and a
// bracket that holds its cut with high probability. It decides how fast the cuts are found, never where they are:
// whoever uses it counts what lies on each side of a bracket and notices where it was wrong.
//
// Invariants
// 1. Nodes are in preorder; the subtree of node g is [g, nodes[g].end).
// 2. The same on every rank: it depends on the sample, the quotas and exact bounds alone.
// 3. A node that missed twice has a bracket that holds its cut for certain: all of the side where it lies.
#pragma once

#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/partition/split_rule.hpp"

namespace rcb::partition {

struct SamplePoint {
  Point at{};
  Id id = 0;
};

// Every rank's points of the sample, in one order on all ranks: one of each `stride` neighbours, chosen by a hash.
// Collective (one gather).
std::vector<SamplePoint> draw_sample(Comm& comm, const particles::ParticleView& particles, std::uint64_t stride);

// A node to begin with: its axis order is exact, and its particles lie in the bounds.
struct FrontierNode {
  NodeRange range;
  AxisOrder axes{0, 1, 2};
  Bounds bounds;
  // Its points in the sample.
  std::size_t sample_first = 0;
  std::size_t sample_last = 0;
  // Where a bracket missed: the cut's first coordinate is known to be in [side_lo, side_hi].
  double side_lo = -std::numeric_limits<double>::infinity();
  double side_hi = std::numeric_limits<double>::infinity();
  int misses = 0;
};

struct GuessNode {
  NodeRange range;
  int depth = 0;  // below its frontier node
  int root = 0;   // the frontier node
  int left = 0;   // of an inner node: g + 1
  int right = 0;
  int end = 0;
  bool inner = false;     // false: a part, or not guessed further
  bool all_left = false;  // by the quotas: no particle goes right
  // With whole: lo_key <= the cut's key <= hi_key; else only the first coordinates are meant.
  bool whole = false;
  AxisOrder axes{0, 1, 2};
  // The order is exact, whatever the cuts above are within their brackets: nothing needs to be measured.
  bool certain = false;
  Bounds outer;         // the particles lie in these, likewise
  double expected = 0;  // particles in the bracket
  double lo = 0;        // first coordinates of the keys, infinite where the bracket is open
  double hi = 0;
  Key lo_key;
  Key hi_key;
};

class Guess {
 public:
  Guess(const SplitRule& rule, const Refinement& refinement, int dims)
      : rule_(rule), refinement_(refinement), dims_(dims) {}

  // Guesses below each of these; reorders each one's points in the sample. Local.
  void grow(std::span<const FrontierNode> frontier, std::span<SamplePoint> sample);

  std::span<const GuessNode> nodes() const { return nodes_; }
  // The guess of each frontier node.
  std::span<const int> roots() const { return roots_; }
  int depth_max() const { return depth_max_; }
  // The greatest depth of a node whose bounds must be measured; 0: none.
  int measured_depth() const { return measured_depth_; }

 private:
  static constexpr double kUnbounded = std::numeric_limits<double>::infinity();
  // What a node to be grown inherits.
  struct Seed {
    NodeRange range;
    int depth = 0;
    Bounds outer;  // its particles lie in these
    // A particle strictly inside these is in the node, likewise.
    Point core_lo{-kUnbounded, -kUnbounded, -kUnbounded};
    Point core_hi{kUnbounded, kUnbounded, kUnbounded};
    double stashed = 0;  // sum of the brackets above, as parts of their nodes
    double spread = 0;   // variance, in points of the sample, of where its own bounds lie
  };

  int grow_node(const Seed& seed, std::span<SamplePoint> sample, const FrontierNode* exact);
  bool descends(const Seed& seed, std::span<const SamplePoint> sample, GuessNode& node) const;
  void grow_children(int index, const Seed& seed, std::span<SamplePoint> sample, std::size_t left_points, double spread,
                     double stashed);
  bool order_is_certain(const AxisOrder& axes, const Bounds& core, const Bounds& outer) const;
  bool order_is_likely(const AxisOrder& axes, const Bounds& inner, const Bounds& outer, std::size_t points) const;
  // Brackets the cut; the sample's first points up to the number returned are left's.
  std::size_t bracket(const Seed& seed, std::span<SamplePoint> sample, GuessNode& node, double sigmas,
                      double& spread) const;

  const SplitRule& rule_;
  const Refinement& refinement_;
  int dims_;
  int root_ = 0;
  int depth_max_ = 0;
  int measured_depth_ = 0;
  std::vector<GuessNode> nodes_;
  std::vector<int> roots_;
};

}  // namespace rcb::partition
