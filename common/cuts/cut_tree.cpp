// CutTree: questions that the tree alone answers. Classification of many particles is in classifier.cpp, the
// bytes (encode, hash) in cut_tree_codec.cpp.
#include "common/cuts/cut_tree.hpp"

#include <algorithm>
#include <limits>

#include "common/base/index.hpp"

namespace rcb::cuts {
namespace {

using geometry::Box;

// Calls visit(range) for every inner node, in preorder.
template <typename Visit>
void for_each_inner(const NodeRange& range, const Visit& visit) {
  if (range.leaf()) return;
  visit(range);
  for_each_inner(range.left(), visit);
  for_each_inner(range.right(), visit);
}

bool goes_right(const Cut& cut, const Point& position, Id id, int dims) {
  return !cut.right_empty && !(key_of(position, id, cut.axes, dims) < cut.key);
}

struct CandidateWalk {
  const CutTree& tree;
  const Point& position;
  std::vector<int>& found;

  // [low, high]: the ids with which a particle at `position` reaches this node.
  void visit(const NodeRange& range, Id low, Id high) {
    if (range.leaf()) {
      found.push_back(range.first);
      return;
    }
    const Cut& cut = tree.cuts[at(range.node)];
    if (cut.right_empty) return visit(range.left(), low, high);
    const bool low_right = goes_right(cut, position, low, tree.dims);
    const bool high_right = goes_right(cut, position, high, tree.dims);
    if (low_right == high_right) return visit(low_right ? range.right() : range.left(), low, high);
    // The position equals the coordinates of the cut's key, so the key's id divides the ids.
    visit(range.left(), low, cut.key.id - 1);
    visit(range.right(), cut.key.id, high);
  }
};

struct RegionWalk {
  const CutTree& tree;
  int first, last;
  std::vector<Box>& out;

  void visit(const NodeRange& range, const Box& box, bool empty) {
    if (range.last <= first || range.first >= last) return;
    if (range.leaf()) {
      out[at(range.first - first)] = empty ? Box{} : box;
      return;
    }
    const Cut& cut = tree.cuts[at(range.node)];
    Box left = box;
    Box right = box;
    const std::size_t a = at(cut.axes[0]);
    if (!cut.right_empty) {  // a cut outside of its node's box leaves one side empty
      left.hi[a] = std::min(box.hi[a], cut.key.at[0]);
      right.lo[a] = std::max(box.lo[a], cut.key.at[0]);
    }
    visit(range.left(), left, empty || left.lo[a] > left.hi[a]);
    visit(range.right(), right, empty || cut.right_empty || right.lo[a] > right.hi[a]);
  }
};

}  // namespace

const Cut* CutTree::cut_of(int first, int last) const {
  for (NodeRange range = root(); !range.leaf();) {
    if (range.first == first && range.last == last) return &cuts[at(range.node)];
    if (first < range.middle() && last > range.middle()) return nullptr;
    range = last <= range.middle() ? range.left() : range.right();
  }
  return nullptr;
}

int CutTree::part_of(const Point& position, Id id) const {
  NodeRange range = root();
  while (!range.leaf()) range = goes_right(cuts[at(range.node)], position, id, dims) ? range.right() : range.left();
  return range.first;
}

std::vector<int> CutTree::candidates(const Point& position) const {
  std::vector<int> found;
  CandidateWalk{*this, position, found}.visit(root(), 0, std::numeric_limits<Id>::max());
  return found;
}

std::vector<Box> CutTree::regions(int first, int last) const {
  RCB_CHECK(first >= 0 && first <= last && last <= parts, "no such parts");
  std::vector<Box> out(at(last - first));
  RegionWalk{*this, first, last, out}.visit(root(), Box::unbounded(), false);
  return out;
}

int axes_flipped(const CutTree& old_tree, const CutTree& new_tree) {
  int flipped = 0;
  if (old_tree.parts == new_tree.parts) {  // then a node's number means the same parts in both
    for (std::size_t k = 0; k < new_tree.cuts.size(); ++k)
      flipped += old_tree.cuts[k].axes[0] != new_tree.cuts[k].axes[0] ? 1 : 0;
    return flipped;
  }
  for_each_inner(new_tree.root(), [&](const NodeRange& range) {
    const Cut* old_cut = old_tree.cut_of(range.first, range.last);
    if (old_cut != nullptr && old_cut->axes[0] != new_tree.cuts[at(range.node)].axes[0]) ++flipped;
  });
  return flipped;
}

}  // namespace rcb::cuts
