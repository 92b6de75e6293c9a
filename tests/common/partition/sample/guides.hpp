// What the tests of guides share.
#pragma once

#include <algorithm>
#include <numeric>
#include <vector>

#include <gtest/gtest.h>

#include "common/base/index.hpp"
#include "common/comm/gather.hpp"
#include "common/partition/partition.hpp"
#include "common/partition/sample/guide.hpp"
#include "tests/support/scenes.hpp"
#include "tests/support/self_comm.hpp"

namespace rcb::partition {

inline CutTree tree_of(const testing::Scene& scene, const PartitionOptions& options) {
  std::vector<std::size_t> rows(scene.count());
  std::iota(rows.begin(), rows.end(), std::size_t{0});
  testing::SelfComm self;
  return partition(self, testing::take(scene, rows).particles.view(), options)->tree;
}

inline std::vector<double> numbers_of(const Guide& guide) {
  std::vector<double> numbers{guide.split ? 1.0 : 0.0};
  for (const auto& [least, most, axis] : guide.splitters.nodes)
    numbers.insert(numbers.end(), {least, most, static_cast<double>(axis)});
  for (const geometry::Point& point : {guide.splitters.rounded.origin, guide.splitters.rounded.scale})
    numbers.insert(numbers.end(), point.begin(), point.end());
  for (const AxisPlan& plan : guide.axes)
    numbers.insert(numbers.end(), {plan.lo, plan.hi, plan.by_order_bits ? 1.0 : 0.0, plan.maybe_lossless ? 1.0 : 0.0});
  return numbers;
}

// Collective.
inline bool same_on_all_ranks(comm::Comm& comm, const std::vector<double>& mine) {
  const Buffer<double> all = comm::all_gather_values<double>(comm, mine).values;
  bool same = all.size() == mine.size() * at(comm.size());
  for (std::size_t i = 0; i < all.size() && same; ++i) same = all[i] == mine[i % mine.size()];
  return same;
}

// How many of a tree's upper cuts lie where they are expected; below a cut across another axis there is nothing to
// compare.
struct Hits {
  int nodes = 0;
  int bracketed = 0;
  int unbounded = 0;

  void count(const CutTree& tree, const Splitters& splitters, const NodeRange& range, std::size_t heap) {
    if (range.leaf() || heap >= Splitters::kNodes) return;
    const Cut& cut = tree.cuts[at(range.node)];
    const auto& [least, most, axis] = splitters.nodes[heap];
    if (cut.right_empty || axis != cut.axes[0]) return;
    const auto rounded = [&](double x) { return splitters.rounded(at(axis), x); };
    ++nodes;
    const float own = rounded(cut.key.at[0]);
    bracketed += rounded(least) <= own && own <= rounded(most) ? 1 : 0;
    unbounded += least == -geometry::Box::kInfinity && most == -least ? 1 : 0;
    count(tree, splitters, range.left(), 2 * heap + 1);
    count(tree, splitters, range.right(), 2 * heap + 2);
  }
};

// All particles that reach a leaf of the tree end in one bucket.
inline void expect_leaves_left(const Splitters& splitters, const NodeRange& range, std::size_t heap) {
  if (heap >= Splitters::kNodes) return;
  if (!range.leaf()) {
    EXPECT_LE(splitters.nodes[heap].least, splitters.nodes[heap].most);
    expect_leaves_left(splitters, range.left(), 2 * heap + 1);
    expect_leaves_left(splitters, range.right(), 2 * heap + 2);
    return;
  }
  for (; heap < Splitters::kNodes; heap = 2 * heap + 1)
    EXPECT_EQ(splitters.nodes[heap].least, geometry::Box::kInfinity);
}

}  // namespace rcb::partition
