// The refined guess against the search level by level and against the judge, bit for bit. Small samples and narrow
// brackets make guesses that are wrong on purpose.
#include "common/partition/refine.hpp"

#include <atomic>

#include <gtest/gtest.h>

#include "common/partition/partition.hpp"
#include "tests/support/judge.hpp"
#include "tests/support/on_ranks.hpp"
#include "tests/support/scenes.hpp"

namespace rcb::partition {
namespace {

using testing::deal;
using testing::judge;
using testing::Judgement;
using testing::JudgeOptions;
using testing::make_scene;
using testing::on_ranks;
using testing::Scene;
using testing::Shape;
using testing::Share;
using testing::Weights;

constexpr std::uint64_t kSeed = 20250117;

// What was met, over all scenes of a test: a test that never misses tests no mending.
struct Met {
  std::atomic<std::uint64_t> missed = 0;
  std::atomic<std::uint64_t> wrong_axes = 0;
  std::atomic<std::uint64_t> passes = 0;
  std::atomic<std::uint64_t> stashed = 0;
};

void check(const Scene& scene, PartitionOptions options, std::uint64_t seed, Met& met) {
  SCOPED_TRACE(scene.name + ", seed " + std::to_string(seed) + ", parts " + std::to_string(options.parts) +
               ", sample " + std::to_string(options.refinement.sample) + ", sigmas " +
               std::to_string(options.refinement.sigmas) + ", method " + std::string(method_name(options.method)));
  JudgeOptions asked;
  asked.parts = options.parts;
  asked.part_sizes = options.part_sizes;
  if (options.method != Method::rcb)
    asked.band_axis = static_cast<int>(options.method) - static_cast<int>(Method::bands_x);
  // With hysteresis the search level by level is the judge: it is judged elsewhere.
  Judgement judged;
  if (options.previous == nullptr) judged = judge(scene, asked);
  on_ranks([&](Comm& comm) {
    const Share share = deal(scene, comm.rank(), comm.size(), seed);
    const particles::ParticleView view = share.particles.view();
    PartitionOptions by_level = options;
    by_level.refinement.points_min = ~std::uint64_t{0};
    PartitionOptions refined = options;
    refined.refinement.points_min = 1;
    const PartitionResult expected = partition(comm, view, by_level).value();
    const PartitionResult got = partition(comm, view, refined).value();
    EXPECT_EQ(expected.refined.passes, 0U);
    EXPECT_EQ(got.tree.cuts, expected.tree.cuts);
    EXPECT_EQ(got.tree.hash(), expected.tree.hash());
    EXPECT_TRUE(std::ranges::equal(got.part, expected.part));
    for (std::size_t i = 0; i < view.count && !judged.part.empty(); ++i)
      if (got.part[i] != judged.part[share.row[i]]) {
        ADD_FAILURE() << "row " << share.row[i] << " is in part " << got.part[i];
        break;
      }
    if (comm.rank() != 0) return;
    met.missed += got.refined.missed;
    met.wrong_axes += got.refined.wrong_axes;
    met.passes += got.refined.passes;
    met.stashed += got.refined.stashed;
  });
}

TEST(Refine, AgreesWithTheSearchByLevelWhateverTheGuess) {
  Met met;
  for (std::uint64_t round = 0; round < 400; ++round) {
    Random random(kSeed + round);
    const auto shape = static_cast<Shape>(random.below(testing::kShapes));
    const int dims = 1 + static_cast<int>(random.below(3));
    const std::size_t count = 1 + random.below(round % 8 == 0 ? 6000 : 900);
    const Scene scene = make_scene(shape, Weights::none, dims, count, random.below(2) == 0, random.next());
    PartitionOptions options;
    options.parts = 1 + static_cast<int>(random.below(round % 4 == 0 ? 200 : 20));
    if (random.below(4) == 0)
      options.method = static_cast<Method>(static_cast<int>(Method::bands_x) +
                                           static_cast<int>(random.below(static_cast<std::uint64_t>(dims))));
    if (random.below(3) == 0)
      for (int p = 0; p < options.parts; ++p) options.part_sizes.push_back(0.01 + random.uniform());
    options.refinement.sample = 1 + random.below(2 * count);
    constexpr std::array kSigmas{0.0, 0.1, 0.5, 1.0, 3.0, 1e3};
    options.refinement.sigmas = kSigmas[random.below(kSigmas.size())];
    check(scene, options, kSeed + round, met);
    if (HasFailure()) return;
  }
  if (!testing::ranks_are_threads()) return;  // enough scenes, all counted here
  EXPECT_GT(met.missed, 0U);
  EXPECT_GT(met.wrong_axes, 0U);
  EXPECT_GT(met.stashed, 0U);
}

TEST(Refine, KeepsAxesWithHysteresis) {
  Met met;
  for (std::uint64_t round = 0; round < 60; ++round) {
    Random random(2 * kSeed + round);
    const int dims = 2 + static_cast<int>(random.below(2));
    const Scene before = make_scene(static_cast<Shape>(random.below(testing::kShapes)), Weights::none, dims,
                                    1 + random.below(800), false, random.next());
    const Scene after = make_scene(static_cast<Shape>(random.below(testing::kShapes)), Weights::none, dims,
                                   1 + random.below(800), false, random.next());
    JudgeOptions first;
    first.parts = 2 + static_cast<int>(random.below(40));
    CutTree previous;
    previous.dims = dims;
    previous.parts = first.parts;
    for (const testing::JudgeCut& cut : judge(before, first).cuts) {
      Cut copy;
      for (std::size_t i = 0; i < cut.axes.size(); ++i) copy.axes[i] = static_cast<std::int8_t>(cut.axes[i]);
      previous.cuts.push_back(copy);
    }
    PartitionOptions options;
    options.parts = first.parts;
    options.previous = &previous;
    options.axis_hysteresis = 1 + random.uniform();
    options.refinement.sample = 1 + random.below(900);
    options.refinement.sigmas = 1;
    check(after, options, 2 * kSeed + round, met);
    if (HasFailure()) return;
  }
}

// A guess that is always wrong costs at most three passes a level.
TEST(Refine, WorkIsBoundedWhateverTheGuess) {
  for (int shape = 0; shape < testing::kShapes; ++shape) {
    const Scene scene = make_scene(static_cast<Shape>(shape), Weights::none, 3, 20000, true, kSeed);
    SCOPED_TRACE(scene.name);
    for (const double sigmas : {0.0, 3.0})
      on_ranks({1, 3}, [&](Comm& comm) {
        const Share share = deal(scene, comm.rank(), comm.size(), kSeed);
        PartitionOptions options;
        options.parts = 16;
        options.refinement = {.points_min = 1, .sample = 500, .sigmas = sigmas};
        const PartitionResult got = partition(comm, share.particles.view(), options).value();
        EXPECT_GE(got.refined.passes, 1U);
        EXPECT_LE(got.refined.passes, 3U * 4U);
        EXPECT_LE(got.rounds, 3U * 4U * 8U * 4U);
      });
  }
}

}  // namespace
}  // namespace rcb::partition
