// Classifier: the parts of many positions by a walk of the tree for all of them at once. It is made once for a tree,
// which costs a pass over its cuts.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/cuts/cut_tree.hpp"
#include "common/cuts/kernels.hpp"

namespace rcb::cuts {

// Positions that are classified together, by axis.
struct Batch {
  static constexpr std::size_t kMost = kBatch;
  alignas(64) std::array<double, geometry::kDimsMax * kMost> x;

  double* axis(std::size_t a) { return x.data() + a * kMost; }
  const double* axis(std::size_t a) const { return x.data() + a * kMost; }
  Point point(std::size_t i, int dims) const {
    Point p{};
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) p[a] = axis(a)[i];
    return p;
  }
};

class Classifier {
 public:
  // The tree must outlive this.
  explicit Classifier(const CutTree& tree);

  // Sets part[i] to the part of position i of the batch. id(i): its id, asked where a cut's plane is hit.
  template <typename IdOf>
  void classify(const Batch& batch, std::size_t count, std::int32_t* part, const IdOf& id) const {
    Ties tied{};
    descend(batch, count, part, tied);
    for (std::size_t i = 0; i < count; ++i) part[i] -= inner_;
    if (std::all_of(tied.begin(), tied.end(), [](std::uint8_t one) { return one == 0; })) return;
    // On a cut's plane the tie-break (the other coordinates, then the id) decides: part_of() compares whole keys.
    for (std::size_t i = 0; i < count; ++i)
      if (tied[i] != 0) part[i] = tree_.part_of(batch.point(i, tree_.dims), id(i));
  }

 private:
  using Ties = std::array<std::uint8_t, Batch::kMost>;  // 1: the position lies on the plane of a cut

  // A node as the descent reads it: steps_[n] is inner node n, steps_[inner nodes + p] is part p. A part is its own
  // child, so that all particles take the same number of steps and no branch depends on their paths.
  struct Step {
    double value;     // the key's first coordinate; infinite where nothing goes right
    std::int32_t at;  // where a batch's coordinates on that axis begin
    std::array<std::int32_t, 2>
        child;  // left, right; chosen by index, since a branch would be mispredicted half the time
  };

  std::int32_t label(const NodeRange& range) const { return range.leaf() ? inner_ + range.first : range.node; }
  void add(const NodeRange& range, int depth);
  // Sets out[i] to the label of the leaf that position i reaches.
  void descend(const Batch& batch, std::size_t count, std::int32_t* out, Ties& tied) const;
  void step(const Batch& batch, std::size_t from, std::size_t end, std::int32_t* out, Ties& tied) const;

  const CutTree& tree_;
  std::int32_t inner_;
  std::int32_t root_ = 0;
  int depth_ = 0;
  std::vector<Step> steps_;
  TopCuts top_{};
};

}  // namespace rcb::cuts
