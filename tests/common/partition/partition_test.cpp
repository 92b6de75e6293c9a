// partition() against the judge of full sorts, on nasty scenes, dealt to ranks in any way.
#include "common/partition/partition.hpp"

#include <cmath>
#include <limits>
#include <map>
#include <mutex>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "tests/support/agreement.hpp"
#include "tests/support/forwarding_comm.hpp"
#include "tests/support/judge.hpp"
#include "tests/support/on_ranks.hpp"
#include "tests/support/scenes.hpp"

namespace rcb::partition {
namespace {

using namespace testing;

constexpr std::uint64_t kPartitionSeed = 20240611;

void check_share(comm::Comm& comm, const Scene& scene, const PartitionOptions& options, const Judgement& judged,
                 std::uint64_t deal_seed) {
  const Share share = deal(scene, comm.rank(), comm.size(), deal_seed);
  const Result<PartitionResult> got = partition(comm, share.particles.view(), options);
  ASSERT_TRUE(got.ok()) << got.status().message();
  ASSERT_EQ(testing::disagreement(*got, share, judged), "");
}

void check(const Scene& scene, const JudgeOptions& asked, const CutTree* previous = nullptr) {
  SCOPED_TRACE(scene.name + ", parts " + std::to_string(asked.parts) + ", band axis " +
               std::to_string(asked.band_axis));
  const Judgement judged = judge(scene, asked);
  std::vector<std::uint64_t> counts(static_cast<std::size_t>(asked.parts), 0);
  for (const std::int32_t part : judged.part) ++counts[static_cast<std::size_t>(part)];
  PartitionOptions options = options_of(asked);
  options.previous = previous;
  on_ranks([&](comm::Comm& comm) { check_share(comm, scene, options, judged, kPartitionSeed + scene.count()); });
}

TEST(Partition, AgreesWithTheJudgeOnEveryShape) {
  std::uint64_t seed = kPartitionSeed;
  for (int shape = 0; shape < testing::kShapes; ++shape)
    for (const int dims : {1, 2, 3})
      for (const int parts : {1, 2, 3, 5, 7, 8, 13, 37, 64}) {
        ++seed;
        JudgeOptions asked;
        asked.parts = parts;
        check(make_scene(static_cast<Shape>(shape), Weights::none, dims, 1 + mix64(seed) % 700, seed % 2 == 0, seed),
              asked);
        if (HasFatalFailure()) return;
      }
}

TEST(Partition, AgreesWithTheJudgeOnEveryWeighting) {
  std::uint64_t seed = 2 * kPartitionSeed;
  for (int shape = 0; shape < testing::kShapes; ++shape)
    for (int weights = 1; weights < testing::kWeights; ++weights)
      for (const int parts : {2, 5, 8, 37}) {
        ++seed;
        JudgeOptions asked;
        asked.parts = parts;
        check(make_scene(static_cast<Shape>(shape), static_cast<Weights>(weights), 1 + static_cast<int>(seed % 3),
                         1 + mix64(seed) % 400, seed % 2 == 0, seed),
              asked);
        if (HasFatalFailure()) return;
      }
}

// Too many particles to gather at once, so that every node is searched by histograms.
TEST(Partition, AgreesWithTheJudgeOnLargerScenes) {
  std::uint64_t seed = 5 * kPartitionSeed;
  for (int shape = 0; shape < testing::kShapes; ++shape)
    for (const Weights weights : {Weights::none, Weights::none, Weights::zeros, Weights::giant, Weights::wide}) {
      ++seed;
      JudgeOptions asked;
      asked.parts = seed % 2 == 0 ? 3 : 40;
      check(make_scene(static_cast<Shape>(shape), weights, 1 + static_cast<int>(seed % 3), 4000 + mix64(seed) % 8000,
                       mix64(seed) % 2 == 0, seed),
            asked);
      if (HasFatalFailure()) return;
    }
}

// Asked between the levels of the tree, so that no partition goes on for long once nobody wants it.
TEST(Partition, EndsBetweenTwoLevelsWhenItIsTold) {
  const Scene scene = make_scene(Shape::uniform, Weights::none, 3, 500, false, kPartitionSeed);
  on_ranks([&](comm::Comm& comm) {
    const Share share = deal(scene, comm.rank(), comm.size(), 7);
    PartitionOptions options;
    options.parts = 64;
    for (int last = 0; last < 9; ++last) {
      int asked = 0;
      const comm::GoOn go_on = [&] { return ++asked <= last; };
      const auto found = partition(comm, share.particles.view(), options, go_on);
      EXPECT_EQ(found.ok(), last >= 7) << last;
      if (!found.ok()) {
        EXPECT_EQ(found.status().code(), Code::aborted);
      }
      EXPECT_EQ(asked, std::min(last + 1, 7));
      if (last < 7) {
        EXPECT_FALSE(partition(
                         comm, share.particles.view(),
                         [] {
                           PartitionOptions order;
                           order.method = Method::file_order;
                           order.parts = 64;
                           return order;
                         }(),
                         [] { return false; })
                         .ok());
      }
    }
  });
}

// The root's cut goes through many particles in one place. The left part's goes through others with one integer in x,
// whose y differ by less than an integer tells: they are not in the place that the root has found.
TEST(Partition, OnePlaceIsNotTakenForAnother) {
  constexpr double kUnit = std::numeric_limits<double>::denorm_min();
  Scene scene;
  scene.dims = 2;
  const auto add = [&](int x, double y, int copies, double step, bool falling) {
    const auto first = static_cast<std::int64_t>(scene.count());
    for (int k = 0; k < copies; ++k) {
      scene.x[0].push_back((1000 + x) * kUnit);
      scene.x[1].push_back(y + k * step);
      scene.id.push_back(first + (falling ? copies - 1 - k : k));
    }
  };
  add(0, 0, 1, 0, false);
  add(599000, 0.5, 30, std::numeric_limits<double>::epsilon(), true);
  add(600000, 0.5, 60, 0, false);
  add(1 << 20, 1, 9, 0, false);
  JudgeOptions asked;
  asked.parts = 4;
  asked.band_axis = 0;
  const Judgement judged = judge(scene, asked);
  PartitionOptions options = options_of(asked);
  options.tuning.gather_max = 1;
  options.tuning.bins_max = 64;
  on_ranks([&](comm::Comm& comm) { check_share(comm, scene, options, judged, kPartitionSeed); });
}

// Ids fill all 31 bits of the integers that they replace, and the cut is near the greatest.
TEST(Partition, TheGreatestKeyWordIsCounted) {
  Scene scene;
  scene.dims = 1;
  for (std::int64_t k = 0; k < 3000; ++k) {
    scene.x[0].push_back(0.5);
    scene.id.push_back(k == 0 ? 0 : std::numeric_limits<std::int32_t>::max() - 2999 + k);
  }
  JudgeOptions asked;
  asked.parts = 2;
  asked.part_sizes = {2998, 2};
  check(scene, asked);
}

// More ids than are gathered share the upper bits that integers hold.
TEST(Partition, IdsFarApartDivideOnePlace) {
  Scene scene;
  scene.dims = 1;
  for (std::int64_t k = 0; k < 6000; ++k) {
    scene.x[0].push_back(0.5);
    scene.id.push_back(k < 4000 ? k : (std::int64_t{1} << 40U) + k * (k % 3 == 0 ? 1 : 1 << 20U));
  }
  for (const int parts : {2, 4, 7}) {
    JudgeOptions asked;
    asked.parts = parts;
    check(scene, asked);
  }
}

TEST(Partition, BandsHaveOneOrder) {
  std::uint64_t seed = 3 * kPartitionSeed;
  for (const Shape shape : {Shape::uniform, Shape::lattice, Shape::planes, Shape::coincident})
    for (int axis = 0; axis < 3; ++axis)
      for (const Weights weights : {Weights::none, Weights::small_integers}) {
        ++seed;
        JudgeOptions asked;
        asked.parts = 7;
        asked.band_axis = axis;
        check(make_scene(shape, weights, 3, 300, false, seed), asked);
        if (HasFatalFailure()) return;
      }
}

TEST(Partition, PartSizes) {
  std::uint64_t seed = 4 * kPartitionSeed;
  for (const Shape shape : {Shape::uniform, Shape::coincident})
    for (const Weights weights : {Weights::none, Weights::uniform, Weights::zeros}) {
      ++seed;
      JudgeOptions asked;
      asked.parts = 6;
      asked.part_sizes = {1, 2.5, 0.001, 1e6, 3, 0.1};
      check(make_scene(shape, weights, 2, 333, true, seed), asked);
      if (HasFatalFailure()) return;
    }
}

TEST(Partition, KeepsAxesWithHysteresis) {
  JudgeOptions first;
  first.parts = 16;
  const Scene before = make_scene(Shape::uniform, Weights::none, 3, 500, false, kPartitionSeed);
  const Judgement old_cuts = judge(before, first);
  CutTree previous;
  on_ranks({1}, [&](comm::Comm& comm) {
    const Share share = deal(before, comm.rank(), comm.size(), 1);
    CutTree tree = partition(comm, share.particles.view(), options_of(first)).value().tree;
    if (comm.rank() == 0) previous = tree;
  });
  for (const double hysteresis : {1.0, 1.0001, 1.2, 2.0, 1e300}) {
    for (const Shape shape : {Shape::uniform, Shape::decades, Shape::huge, Shape::coincident}) {
      const Scene after =
          make_scene(shape, Weights::none, 3, shape == Shape::coincident ? 5 : 400, false, kPartitionSeed + 1);
      JudgeOptions asked = first;
      asked.hysteresis = hysteresis;
      for (const JudgeCut& cut : old_cuts.cuts) asked.old_axis.push_back(cut.axes[0]);
      CutTree everywhere = previous;
      if (everywhere.cuts.empty()) {  // on MPI rank 0 alone has it
        everywhere.parts = first.parts;
        for (const JudgeCut& cut : old_cuts.cuts) {
          Cut copy;
          for (std::size_t i = 0; i < 3; ++i) copy.axes[i] = static_cast<std::int8_t>(cut.axes[i]);
          everywhere.cuts.push_back(copy);
        }
      }
      check(after, asked, &everywhere);
      if (HasFatalFailure()) return;
    }
  }
}

TEST(Partition, ManyPartsFewParticles) {
  for (const std::size_t count : {0U, 1U, 5U, 100U, 5000U}) {
    JudgeOptions asked;
    asked.parts = 4096;
    check(make_scene(Shape::lattice, Weights::none, 3, count, false, kPartitionSeed + count), asked);
    check(make_scene(Shape::uniform, Weights::uniform, 2, count, true, kPartitionSeed + count), asked);
    if (HasFatalFailure()) return;
  }
}

TEST(Partition, FivePointsInEightParts) {
  const Judgement judged = judge(make_scene(Shape::uniform, Weights::none, 2, 5, false, 1), {.parts = 8});
  EXPECT_EQ(judged.quota, (std::vector<std::int64_t>{0, 1, 0, 1, 1, 0, 1, 1}));
}

TEST(Partition, RoundsAreBounded) {
  // Large enough for the histogram search on every level; at most 8 rounds a level for each key word, and mostly two.
  for (int shape = 0; shape < testing::kShapes; ++shape)
    for (const Weights weights : {Weights::none, Weights::zeros}) {
      const Scene scene = make_scene(static_cast<Shape>(shape), weights, 3, 20000, true, kPartitionSeed);
      SCOPED_TRACE(scene.name);
      PartitionOptions options;
      options.parts = 8;
      std::mutex mutex;
      std::map<std::uint64_t, int> hashes;
      on_ranks({1, 3}, [&](comm::Comm& comm) {
        const Share share = deal(scene, comm.rank(), comm.size(), kPartitionSeed);
        const PartitionResult got = partition(comm, share.particles.view(), options).value();
        EXPECT_LE(got.cost.rounds, static_cast<Shape>(shape) == Shape::coincident ? 3U * 8U : 3U * 8U * 4U);
        const std::lock_guard lock(mutex);
        ++hashes[got.tree.hash()];
      });
      EXPECT_EQ(hashes.size(), 1U);
    }
}

struct CountingComm final : testing::ForwardingComm {
  using ForwardingComm::ForwardingComm;
  void before() override { ++collectives; }
  std::uint64_t collectives = 0;
};

// However few the particles are.
PartitionOptions with_buckets(PartitionOptions options) {
  options.tuning.sample = {.count_min = 0, .per_part_min = 0, .stride = 32, .sample_min = 1};
  return options;
}

// A large set begins with the buckets of a sample; the answer is that of a search among all particles.
TEST(Partition, BucketsChangeNoAnswer) {
  for (const Shape shape : {Shape::uniform, Shape::half_coincident, Shape::offset, Shape::lattice})
    for (const int parts : {4, 9, 64, 200}) {
      const Scene scene = make_scene(shape, Weights::none, 3, 50000, false, kPartitionSeed);
      SCOPED_TRACE(fmt::format("{}, {} parts", scene.name, parts));
      PartitionOptions options;
      options.parts = parts;
      options.tuning.sample.count_min = scene.count() + 1;
      on_ranks([&](comm::Comm& comm) {
        const Share share = deal(scene, comm.rank(), comm.size(), kPartitionSeed);
        const PartitionResult all = partition(comm, share.particles.view(), options).value();
        CountingComm counting(comm);
        const PartitionResult bucketed = partition(counting, share.particles.view(), with_buckets(options)).value();
        EXPECT_EQ(bucketed.cost.reductions, counting.collectives);
        EXPECT_EQ(bucketed.tree.hash(), all.tree.hash());
        EXPECT_TRUE(std::equal(bucketed.part.begin(), bucketed.part.end(), all.part.begin(), all.part.end()));
        EXPECT_EQ(bucketed.counts, all.counts);
      });
    }
}

TEST(Partition, RefusesBadOptions) {
  const Scene scene = make_scene(Shape::uniform, Weights::none, 2, 10, false, 1);
  on_ranks([&](comm::Comm& comm) {
    const Share share = deal(scene, comm.rank(), comm.size(), 1);
    const auto refused = [&](const PartitionOptions& options) {
      const Result<PartitionResult> got = partition(comm, share.particles.view(), options);
      return !got.ok() && got.status().code() == Code::invalid_argument;
    };
    EXPECT_TRUE(refused({.parts = 0}));
    EXPECT_TRUE(refused({.parts = 2, .part_sizes = {1}}));
    EXPECT_TRUE(refused({.parts = 2, .part_sizes = {1, 0}}));
    EXPECT_TRUE(refused({.parts = 2, .part_sizes = {1, std::nan("")}}));
    EXPECT_TRUE(refused({.parts = 2, .axis_hysteresis = 0.5}));
    EXPECT_TRUE(refused({.method = Method::bands_z, .parts = 2}));
  });
}

}  // namespace
}  // namespace rcb::partition
