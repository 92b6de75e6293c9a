// Guides against the partitions that they guess, and by brute force.
#include "common/partition/sample/guide.hpp"

#include <algorithm>
#include <mutex>
#include <numeric>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "common/base/cpu.hpp"
#include "common/base/index.hpp"
#include "common/partition/partition.hpp"
#include "tests/common/partition/sample/guides.hpp"
#include "tests/support/on_ranks.hpp"
#include "tests/support/scenes.hpp"
#include "tests/support/self_comm.hpp"

namespace rcb::partition {
namespace {

using namespace testing;

constexpr std::uint64_t kGuideSeed = 20261129;

PartitionOptions with_samples(int parts) {
  PartitionOptions options;
  options.parts = parts;
  options.tuning.sample.count_min = options.tuning.sample.per_part_min = 1;
  options.tuning.sample.parts_min = 2;
  options.tuning.sample.sample_min = 2000;
  return options;
}

TEST(GuideOfLargeSet, IsTheSameOnAllRanksAndBracketsTheCuts) {
  if (!has_avx2()) GTEST_SKIP() << "no sample without AVX2";
  Hits hits;
  for (const Shape shape : {Shape::uniform, Shape::clusters, Shape::offset, Shape::decades, Shape::huge})
    for (const int parts : {2, 5, 64, 100}) {
      const Scene scene = make_scene(shape, Weights::none, 3, 20'000, false, kGuideSeed + at(parts));
      SCOPED_TRACE(fmt::format("{}, {} parts", scene.name, parts));
      const PartitionOptions options = with_samples(parts);
      const CutTree tree = tree_of(scene, options);
      std::mutex mutex;
      on_ranks([&](comm::Comm& comm) {
        const Share share = deal(scene, comm.rank(), comm.size(), kGuideSeed);
        SearchCost cost;
        const Guide large = guide_of_set(comm, share.particles.view(), options, cost).guide;
        EXPECT_TRUE(large.split);
        EXPECT_EQ(cost.reductions, 3U);
        EXPECT_TRUE(same_on_all_ranks(comm, numbers_of(large)));
        const std::scoped_lock lock(mutex);
        hits.count(tree, large.splitters, tree.root(), 0);
        expect_leaves_left(large.splitters, tree.root(), 0);
        for (std::size_t a = 0; a < 3 && shape == Shape::uniform; ++a) {
          const AxisPlan& plan = large.axes[a];
          const auto [least, most] = std::ranges::minmax(scene.x[a]);
          EXPECT_LE(plan.lo, least);
          EXPECT_GE(plan.hi, most);
          EXPECT_LE(plan.hi - plan.lo, 3 * (most - least));
          EXPECT_GE(plan.hi - plan.lo, 1.9 * (most - least));
        }
      });
    }
  EXPECT_GT(hits.nodes, 100);
  EXPECT_GT(hits.bracketed, 0.97 * hits.nodes);
  EXPECT_LT(hits.unbounded, 0.2 * hits.nodes);
}

TEST(GuideOfLargeSet, IsLeftWhereItWouldSaveNothing) {
  const Scene scene = make_scene(Shape::uniform, Weights::none, 3, 5000, false, kGuideSeed);
  const Scene weighted = make_scene(Shape::uniform, Weights::uniform, 3, 5000, false, kGuideSeed);
  on_ranks([&](comm::Comm& comm) {
    SearchCost cost;
    const auto made = [&](const PartitionOptions& options, const Scene& of) {
      const Share share = deal(of, comm.rank(), comm.size(), kGuideSeed);
      return guide_of_set(comm, share.particles.view(), options, cost).guide.split;
    };
    const PartitionOptions options = with_samples(8);
    EXPECT_EQ(made(options, scene), has_avx2());
    EXPECT_FALSE(made(options, weighted));
    PartitionOptions other = options;
    other.cut_tolerance = 0.1;
    EXPECT_FALSE(made(other, scene));
    other = options;
    other.tuning.sample.count_min = 5001;
    EXPECT_FALSE(made(other, scene));
    other = options;
    other.tuning.sample.per_part_min = 1000;
    EXPECT_FALSE(made(other, scene));
    other = options;
    other.tuning.sample.parts_min = 9;
    EXPECT_FALSE(made(other, scene));
  });
}

// The plan of all coordinates of the scene, as one rank would make it.
SetGuide alone(const Scene& scene, const PartitionOptions& options) {
  testing::SelfComm self;
  std::vector<std::size_t> rows(scene.count());
  std::iota(rows.begin(), rows.end(), std::size_t{0});
  SearchCost cost;
  return guide_of_set(self, testing::take(scene, rows).particles.view(), options, cost);
}

TEST(GuideOfSmallSet, DependsOnTheParticlesAloneUnderACutTolerance) {
  int by_order_bits = 0;
  int lossless = 0;
  for (int shape = 0; shape < kShapes; ++shape)
    for (const std::size_t count : {0U, 1U, 700U, 9000U}) {
      const Scene scene =
          make_scene(static_cast<Shape>(shape), Weights::none, 1 + shape % 3, count, true, kGuideSeed + count);
      SCOPED_TRACE(fmt::format("{}, {} particles", scene.name, count));
      PartitionOptions options;
      options.cut_tolerance = 0.05;
      geometry::Box box;
      const SetGuide expected = alone(scene, options);
      // By brute force: ids chosen by a hash, and both maps of the exact range.
      for (std::size_t a = 0; a < at(scene.dims) && count > 0; ++a) {
        const auto [least, most] = std::ranges::minmax(scene.x[a]);
        EXPECT_EQ(expected.guide.axes[a].lo, least);
        EXPECT_EQ(expected.guide.axes[a].hi, most);
        std::array<std::array<int, 512>, 2> bins{};
        const std::array maps{AxisMap::by_value(least, most), AxisMap::by_order_bits(least, most)};
        for (std::size_t i = 0; i < count; ++i)
          if (mix64(static_cast<std::uint64_t>(scene.id[i])) % (count / 4096 + 1) == 0)
            for (std::size_t m = 0; m < 2; ++m)
              ++bins[m][at(std::int64_t{maps[m](scene.x[a][i])} * 511 / std::max(maps[m](most), 1))];
        EXPECT_EQ(expected.guide.axes[a].by_order_bits, std::ranges::max(bins[0]) > 2 * std::ranges::max(bins[1]));
        by_order_bits += expected.guide.axes[a].by_order_bits ? 1 : 0;
        lossless += expected.guide.axes[a].maybe_lossless ? 1 : 0;
      }
      for (const std::uint64_t seed : {1U, 2U, 3U})
        on_ranks([&](comm::Comm& comm) {
          const Share share = deal(scene, comm.rank(), comm.size(), seed);
          SearchCost cost;
          const SetGuide all = guide_of_set(comm, share.particles.view(), options, cost);
          EXPECT_EQ(numbers_of(all.guide), numbers_of(expected.guide));
          EXPECT_EQ(all.box, expected.box);
          EXPECT_EQ(all.count, scene.count());
          EXPECT_EQ(cost.reductions, 2U);
        });
    }
  EXPECT_GT(by_order_bits, 3);
  EXPECT_GT(lossless, 5);
}

TEST(GuideOfSmallSet, IsTheSameOnAllRanksWithTheExactBox) {
  for (int shape = 0; shape < kShapes; ++shape) {
    const Scene scene = make_scene(static_cast<Shape>(shape), Weights::none, 1 + shape % 3, 3000, true, kGuideSeed);
    SCOPED_TRACE(scene.name);
    const geometry::Box box = alone(scene, {}).box;
    on_ranks([&](comm::Comm& comm) {
      const Share share = deal(scene, comm.rank(), comm.size(), kGuideSeed);
      SearchCost cost;
      const SetGuide all = guide_of_set(comm, share.particles.view(), {}, cost);
      const Guide& guide = all.guide;
      EXPECT_TRUE(same_on_all_ranks(comm, numbers_of(guide)));
      EXPECT_EQ(cost.reductions, 2U);
      EXPECT_EQ(all.box, box);
      EXPECT_FALSE(guide.split);
      for (std::size_t a = 0; a < at(scene.dims); ++a) {
        EXPECT_EQ(guide.axes[a].lo, std::ranges::min(scene.x[a]));
        EXPECT_EQ(guide.axes[a].hi, std::ranges::max(scene.x[a]));
      }
    });
  }
}

}  // namespace
}  // namespace rcb::partition
