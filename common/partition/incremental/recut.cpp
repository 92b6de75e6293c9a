#include "common/partition/incremental/recut.hpp"

#include <numeric>

namespace rcb::partition {
namespace {

struct RootFinder {
  const LoadSummary& loads;
  double wanted;
  std::vector<u128> sizes;
  u128 total = 0;
  u128 all_sizes = 0;
  std::vector<NodeRange> found;

  // |load / target - 1| of a node: the error that its parts have once they share its load.
  double error_of(const NodeRange& range) const {
    const auto first = range.first;
    const auto last = range.last;
    u128 load = 0;
    u128 size = 0;
    for (auto p = static_cast<std::size_t>(first); p < static_cast<std::size_t>(last); ++p) {
      load += loads.loads[p];
      size += sizes[p];
    }
    if (total == 0) return 0;
    return relative_error(load, total, size, all_sizes);
  }

  // True if some part of the node is off its target and no root found in the node so far covers it.
  bool visit(const NodeRange& range) {
    if (range.leaf()) return loads.part_errors[static_cast<std::size_t>(range.first)] >= wanted;
    const std::size_t before = found.size();
    const bool left = visit(range.left());
    const bool right = visit(range.right());
    if (!left && !right) return false;
    if (error_of(range) >= wanted) return true;
    found.resize(before);
    found.push_back(range);
    return false;
  }
};

}  // namespace

std::vector<NodeRange> smallest_roots(const CutTree& tree, const LoadSummary& loads, double wanted) {
  RootFinder walk{loads, wanted, exact_sizes(tree.part_sizes, tree.parts), 0, 0, {}};
  walk.total = std::accumulate(loads.loads.begin(), loads.loads.end(), u128{0});
  walk.all_sizes = std::accumulate(walk.sizes.begin(), walk.sizes.end(), u128{0});
  const bool open = walk.visit(tree.root());
  if (open || (tree.method != Method::rcb && !walk.found.empty())) return {tree.root()};
  return walk.found;
}

}  // namespace rcb::partition
