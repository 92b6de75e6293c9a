#include "common/cuts/cut_tree.hpp"

#include <algorithm>
#include <limits>

#include <gtest/gtest.h>

#include "common/cuts/cuts.hpp"
#include "common/partition/partition.hpp"
#include "tests/support/scenes.hpp"
#include "tests/support/self_comm.hpp"

namespace rcb::cuts {
namespace {

using geometry::Box;
using testing::deal;
using testing::make_scene;
using testing::Shape;
using testing::Share;
using testing::Weights;

constexpr std::uint64_t kTreeSeed = 5150;

CutTree tree_of(Shape shape, int dims, std::size_t count, int parts, std::uint64_t seed = kTreeSeed) {
  testing::SelfComm comm;
  const Share share = deal(make_scene(shape, Weights::none, dims, count, false, seed), 0, 1, seed);
  partition::PartitionOptions options;
  options.parts = parts;
  return partition::partition(comm, share.particles.view(), options).value().tree;
}

// The example of docs/hash.md.
CutTree example() {
  CutTree tree;
  tree.dims = 2;
  tree.parts = 2;
  tree.cuts.resize(1);
  tree.cuts[0].key.at = {1.5, -2, 0};
  tree.cuts[0].key.id = 7;
  return tree;
}

TEST(CutTree, HashesAsTheDocumentSays) {
  EXPECT_EQ(example().encode().size(), 51U);
  EXPECT_EQ(example().hash(), 0xA21AD9C488810725ULL);
}

TEST(CutTree, HashTellsTreesApart) {
  const std::uint64_t before = example().hash();
  CutTree other = example();
  other.cuts[0].key.id = 8;
  EXPECT_NE(other.hash(), before);
  other = example();
  other.method = Method::bands_x;
  EXPECT_NE(other.hash(), before);
  other = example();
  other.part_sizes = {1, 2};
  EXPECT_NE(other.hash(), before);
  other.part_sizes = {2, 2};  // equal sizes are none
  EXPECT_EQ(other.hash(), before);
  other = example();
  other.cuts[0].key.at = {-0.0, -2, 0};
  CutTree zero = example();
  zero.cuts[0].key.at = {0.0, -2, 0};
  EXPECT_EQ(other.hash(), zero.hash());
}

TEST(CutTree, TheWholeKeyDecides) {
  const CutTree tree = example();
  EXPECT_EQ(tree.part_of({1.4, 9, 0}, 9), 0);
  EXPECT_EQ(tree.part_of({1.5, -3, 0}, 9), 0);
  EXPECT_EQ(tree.part_of({1.5, -2, 0}, 6), 0);
  EXPECT_EQ(tree.part_of({1.5, -2, 0}, 7), 1);
  EXPECT_EQ(tree.part_of({1.5, -1, 0}, 0), 1);
  EXPECT_EQ(tree.candidates({1.5, -2, 0}), (std::vector<int>{0, 1}));
  EXPECT_EQ(tree.candidates({1.5, -2.5, 0}), (std::vector<int>{0}));
  EXPECT_EQ(tree.candidates({1.5, 0, 0}), (std::vector<int>{1}));
}

TEST(CutTree, IdZeroLeavesNothingToTheLeft) {
  CutTree tree = example();
  tree.cuts[0].key.id = 0;
  EXPECT_EQ(tree.candidates({1.5, -2, 0}), (std::vector<int>{1}));
}

TEST(CutTree, CandidatesAreTheOwnersOfSomeId) {
  // Coincident points: the ids alone divide them, on several levels.
  const CutTree tree = tree_of(Shape::coincident, 2, 100, 9);
  EXPECT_EQ(tree.candidates({0.25, 1.25, 0}), (std::vector<int>{0, 1, 2, 3, 4, 5, 6, 7, 8}));
  for (int shape = 0; shape < testing::kShapes; ++shape) {
    const CutTree other = tree_of(static_cast<Shape>(shape), 3, 200, 13);
    const auto scene = make_scene(static_cast<Shape>(shape), Weights::none, 3, 200, false, kTreeSeed);
    for (std::size_t i = 0; i < scene.count(); ++i) {
      const Point position{scene.x[0][i], scene.x[1][i], scene.x[2][i]};
      std::vector<int> owners;
      for (Id id = 0; id < 200; ++id) owners.push_back(other.part_of(position, id));
      owners.push_back(other.part_of(position, std::numeric_limits<Id>::max()));
      std::ranges::sort(owners);
      owners.erase(std::unique(owners.begin(), owners.end()), owners.end());
      EXPECT_EQ(other.candidates(position), owners);
    }
  }
}

TEST(CutTree, RegionsHoldTheirParticlesAndMeetTouchingBoxes) {
  for (int shape = 0; shape < testing::kShapes; ++shape)
    for (const int dims : {1, 2, 3}) {
      const CutTree tree = tree_of(static_cast<Shape>(shape), dims, 150, 11);
      const Cuts cuts(tree, 1);
      const std::vector<Box> regions = tree.regions(0, tree.parts);
      const auto scene = make_scene(static_cast<Shape>(shape), Weights::none, dims, 150, false, kTreeSeed);
      Random random(kTreeSeed);
      for (std::size_t i = 0; i < scene.count(); ++i) {
        Box box;
        for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) {
          const double other = scene.x[a][random.below(scene.count())];
          box.lo[a] = std::min(scene.x[a][i], other);
          box.hi[a] = std::max(scene.x[a][i], other);
        }
        std::vector<int> touching;
        for (int p = 0; p < tree.parts; ++p) {
          const Box& region = regions[static_cast<std::size_t>(p)];
          bool meets = !region.empty(dims);
          for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a)
            meets = meets && region.lo[a] <= box.hi[a] && box.lo[a] <= region.hi[a];
          if (meets) touching.push_back(p);
        }
        EXPECT_EQ(cuts.box(box).value(), touching);
      }
    }
}

TEST(CutTree, EmptyRightSidesHaveEmptyRegions) {
  const CutTree tree = tree_of(Shape::uniform, 2, 0, 4);
  const std::vector<Box> regions = tree.regions(0, 4);
  EXPECT_FALSE(regions[0].empty(2));
  for (const std::size_t part : {1U, 2U, 3U}) EXPECT_TRUE(regions[part].empty(2));
  EXPECT_EQ(Cuts(tree, 1).box(Box::unbounded()).value(), (std::vector<int>{0}));
  EXPECT_EQ(tree.part_of({4, 4, 0}, 4), 0);
}

TEST(CutTree, CountsFlippedAxes) {
  CutTree old_tree = tree_of(Shape::uniform, 3, 500, 8);
  CutTree new_tree = old_tree;
  EXPECT_EQ(axes_flipped(old_tree, new_tree), 0);
  std::swap(new_tree.cuts[2].axes[0], new_tree.cuts[2].axes[1]);
  std::swap(new_tree.cuts[4].axes[1], new_tree.cuts[4].axes[2]);  // not the cut axis
  EXPECT_EQ(axes_flipped(old_tree, new_tree), 1);
  // 4 parts: [0, 4) and [0, 2), [2, 4) are nodes of the tree of 8 too.
  CutTree half = tree_of(Shape::uniform, 3, 500, 4);
  for (Cut& cut : half.cuts) cut.axes = {0, 1, 2};
  for (Cut& cut : new_tree.cuts) cut.axes = {1, 0, 2};
  EXPECT_EQ(axes_flipped(half, new_tree), 3);
  EXPECT_EQ(axes_flipped(new_tree, half), 3);
  EXPECT_EQ(axes_flipped(CutTree{}, new_tree), 0);
}

TEST(Method, NamesRoundTrip) {
  for (const Method method :
       {Method::rcb, Method::bands_x, Method::bands_y, Method::bands_z, Method::equal_boxes, Method::file_order}) {
    EXPECT_EQ(method_from_name(method_name(method)), method);
    EXPECT_EQ(has_cut_tree(method), method != Method::file_order);
  }
  EXPECT_FALSE(method_from_name("RCB").has_value());
}

}  // namespace
}  // namespace rcb::cuts
