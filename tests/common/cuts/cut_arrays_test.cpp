#include "common/cuts/cut_arrays.hpp"

#include <array>
#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include "common/partition/partition.hpp"
#include "tests/support/scenes.hpp"
#include "tests/support/self_comm.hpp"

namespace rcb::cuts {
namespace {

constexpr std::uint64_t kArraysSeed = 4711;

CutTree tree_of_scene(testing::Shape shape, int dims, std::size_t count, int parts) {
  testing::SelfComm comm;
  const auto scene = testing::make_scene(shape, testing::Weights::none, dims, count, false, kArraysSeed);
  const testing::Share share = testing::deal(scene, 0, 1, kArraysSeed);
  partition::PartitionOptions options;
  options.parts = parts;
  return partition::partition(comm, share.particles.view(), options).value().tree;
}

CutArrays good_arrays() { return arrays_of(tree_of_scene(testing::Shape::uniform, 3, 300, 7)); }

void spoil(CutArrays& arrays, Random& random) {
  const auto some = [&random](auto& values) -> auto& { return values[random.below(values.size())]; };
  const double inf = std::numeric_limits<double>::infinity();
  const std::array<double, 6> odd{-0.0, inf, std::nan(""), -1, 1e308, 5e-324};
  switch (random.below(8)) {
    case 0:
      arrays.dims = static_cast<int>(random.below(6)) - 1;
      break;
    case 1:
      arrays.parts = static_cast<int>(random.next());
      break;
    case 2:
      arrays.method = static_cast<Method>(random.below(8));
      break;
    case 3:
      arrays.part_sizes.assign(random.below(10), some(odd));
      break;
    case 4:
      arrays.axes.resize(random.below(40), 1);
      break;
    case 5:
      if (!arrays.axes.empty()) some(arrays.axes) = static_cast<std::int32_t>(random.below(5)) - 1;
      break;
    case 6:
      if (!arrays.at.empty()) some(arrays.at) = some(odd);
      break;
    default:
      if (!arrays.id.empty()) some(arrays.id) = static_cast<Id>(random.below(4)) - 2;
      break;
  }
}

TEST(CutArrays, RoundTrip) {
  for (int shape = 0; shape < testing::kShapes; ++shape)
    for (const int dims : {1, 2, 3})
      for (const std::size_t count :
           {std::size_t{0}, std::size_t{5}, std::size_t{200}})  // fewer than parts: empty sides
        for (const int parts : {1, 2, 13}) {
          CutTree tree = tree_of_scene(static_cast<testing::Shape>(shape), dims, count, parts);
          if (count == 200) tree.part_sizes.assign(static_cast<std::size_t>(parts), 0.5), tree.part_sizes[0] = 1;
          const auto back = tree_of(arrays_of(tree));
          ASSERT_TRUE(back.ok()) << back.status().message();
          EXPECT_EQ(back->hash(), tree.hash());
          EXPECT_EQ(back->part_sizes, tree.part_sizes);
          for (std::size_t k = 0; k < tree.cuts.size(); ++k) {
            Cut& cut = tree.cuts[k];
            if (cut.right_empty) cut.key = {};  // unused
            EXPECT_EQ(back->cuts[k], cut);
          }
        }
}

TEST(CutArrays, NegativeZeroIsZero) {
  CutArrays arrays = good_arrays();
  arrays.at[0] = 0.0;
  const std::uint64_t hash = tree_of(arrays)->hash();
  arrays.at[0] = -0.0;
  EXPECT_FALSE(std::signbit(tree_of(arrays)->cuts[0].key.at[0]));
  EXPECT_EQ(tree_of(arrays)->hash(), hash);
}

TEST(CutArrays, WhatIsNoTreeIsRefused) {
  const auto refused = [](auto&& spoil) {
    CutArrays arrays = good_arrays();
    spoil(arrays);
    return tree_of(arrays).status().code() == Code::protocol_error;
  };
  EXPECT_FALSE(refused([](CutArrays&) {}));
  for (const int dims : {-1, 0, 2, 4}) EXPECT_TRUE(refused([&](CutArrays& a) { a.dims = dims; })) << dims;
  for (const int parts : {std::numeric_limits<int>::min(), -1, 0, 1, 6, 8, std::numeric_limits<int>::max()})
    EXPECT_TRUE(refused([&](CutArrays& a) { a.parts = parts; })) << parts;
  EXPECT_TRUE(refused([](CutArrays& a) {  // the lengths are right
    a.dims = 1;
    a.parts = (1 << 20) + 1;
    a.axes.assign(1 << 20, 0);
    a.at.assign(1 << 20, 0);
    a.id.assign(1 << 20, 0);
  }));
  for (const int method : {-1, static_cast<int>(Method::file_order), 6})
    EXPECT_TRUE(refused([&](CutArrays& a) { a.method = static_cast<Method>(method); })) << method;
  EXPECT_TRUE(refused([](CutArrays& a) { a.axes.pop_back(); }));
  EXPECT_TRUE(refused([](CutArrays& a) { a.at.push_back(0); }));
  EXPECT_TRUE(refused([](CutArrays& a) { a.id.clear(); }));
  EXPECT_TRUE(refused([](CutArrays& a) { a.part_sizes = {1, 2}; }));
  for (const int axis : {-1, 3, 1 << 8}) EXPECT_TRUE(refused([&](CutArrays& a) { a.axes[4] = axis; })) << axis;
  EXPECT_TRUE(refused([](CutArrays& a) { a.axes[3] = a.axes[4]; }));
  const double inf = std::numeric_limits<double>::infinity();
  for (const double x : {inf, -inf, std::nan("")}) {
    EXPECT_TRUE(refused([&](CutArrays& a) { a.at[5] = x; }));
    EXPECT_TRUE(refused([&](CutArrays& a) { a.part_sizes.assign(7, 1), a.part_sizes[6] = x; }));
  }
  for (const double size : {-1.0, -0.0, 0.0})
    EXPECT_TRUE(refused([&](CutArrays& a) { a.part_sizes.assign(7, 1), a.part_sizes[6] = size; }));
  for (const Id id : {Id{-2}, std::numeric_limits<Id>::min()})
    EXPECT_TRUE(refused([&](CutArrays& a) { a.id[1] = id; }));
}

// Whatever the arrays hold, they are refused or a tree that can be asked.
TEST(CutArrays, FuzzedArraysNeverCrash) {
  Random random(kArraysSeed);
  const CutArrays good = good_arrays();
  int taken = 0;
  for (int round = 0; round < 20'000; ++round) {
    CutArrays arrays = good;
    for (std::uint64_t k = random.below(4); k > 0; --k) spoil(arrays, random);
    const auto tree = tree_of(arrays);
    if (!tree) continue;
    ++taken;
    const int part = tree->part_of({random.uniform(), random.uniform(), 0}, 3);
    ASSERT_TRUE(part >= 0 && part < tree->parts) << "seed " << kArraysSeed << ", round " << round;
    ASSERT_EQ(tree->regions(0, tree->parts).size(), static_cast<std::size_t>(tree->parts));
    ASSERT_EQ(tree_of(arrays_of(*tree))->hash(), tree->hash());
  }
  EXPECT_GT(taken, 1000);
}

}  // namespace
}  // namespace rcb::cuts
