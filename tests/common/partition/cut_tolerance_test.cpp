// Searches that stop early: what they promise of the error, and that the answer is still one answer.
#include <algorithm>
#include <cmath>
#include <mutex>
#include <set>

#include <gtest/gtest.h>

#include "common/partition/balance/load.hpp"
#include "common/partition/partition.hpp"
#include "tests/support/on_ranks.hpp"
#include "tests/support/scenes.hpp"

namespace rcb::partition {
namespace {

using namespace testing;

constexpr std::uint64_t kToleranceSeed = 20261121;

struct Met {
  std::mutex mutex;
  std::set<std::uint64_t> hashes;
  double error = 0;
  LoadSummary loads;
  std::uint64_t reductions = 0;
};

void run(const Scene& scene, const PartitionOptions& options, Met& met) {
  on_ranks([&](comm::Comm& comm) {
    const Share share = deal(scene, comm.rank(), comm.size(), kToleranceSeed);
    const particles::ParticleView view = share.particles.view();
    const PartitionResult got = partition(comm, view, options).value();
    for (std::size_t i = 0; i < view.count; ++i)
      if (got.tree.part_of(view.point(i), view.id[i]) != got.part[i]) {
        ADD_FAILURE() << "the tree and the partition disagree on particle " << view.id[i];
        break;
      }
    LoadSummary loads = summarise_loads(comm, view, got.part.span(), options.part_sizes, options.parts);
    const std::lock_guard lock(met.mutex);
    met.hashes.insert(got.tree.hash());
    met.error = loads.error;
    met.loads = std::move(loads);
    met.reductions = got.cost.reductions;
  });
}

// A level adds less than one whole particle to what the tolerance allows; with weights, at most half the greatest
// weight.
TEST(CutTolerance, BoundsTheErrorOfEveryPart) {
  for (std::uint64_t round = 0; round < 160; ++round) {
    Random random(kToleranceSeed + round);
    const auto shape = static_cast<Shape>(random.below(testing::kShapes));
    const Weights weights = round % 3 == 0 ? Weights::uniform : Weights::none;
    const Scene scene = make_scene(shape, weights, 1 + static_cast<int>(random.below(3)), 4000 + random.below(4000),
                                   true, kToleranceSeed + round);
    PartitionOptions options;
    options.parts = 2 + static_cast<int>(random.below(40));
    if (random.below(3) == 0)
      for (int p = 0; p < options.parts; ++p) options.part_sizes.push_back(0.5 + random.uniform());
    options.tuning.gather_max = 1 + random.below(40);
    constexpr std::array kTolerances{0.001, 0.02, 0.1, 0.5, 1.0};
    options.cut_tolerance = kTolerances[random.below(kTolerances.size())];
    SCOPED_TRACE(scene.name + ", parts " + std::to_string(options.parts) + ", cut tolerance " +
                 std::to_string(options.cut_tolerance) + ", seed " + std::to_string(kToleranceSeed + round));
    Met met;
    run(scene, options, met);
    EXPECT_EQ(met.hashes.size(), 1U);
    const double whole = scene.weight.empty() ? 1 : *std::ranges::max_element(scene.weight) / 2;
    const double levels = std::ceil(std::log2(options.parts));
    for (std::size_t p = 0; p < met.loads.targets.size(); ++p) {
      const double target = met.loads.targets[p];
      EXPECT_LE(std::abs(met.loads.load_values[p] - target),
                (1 + 1e-12) * (options.cut_tolerance * target + levels * whole))
          << "part " << p;
    }
    if (HasFailure()) return;
  }
}

// The bins are equal steps of the value or of its image, as a sample of the particles suggests: scenes for which that
// hangs in the balance.
TEST(CutTolerance, TheBinsAreTheSameHoweverTheParticlesAreDealt) {
  for (int step = 0; step < 60; ++step) {
    Scene scene =
        make_scene(Shape::uniform, Weights::none, 1, 20000, true, kToleranceSeed + static_cast<std::uint64_t>(step));
    for (double& x : scene.x[0]) x = std::pow(10.0, -0.1 * step * x);
    PartitionOptions options;
    options.parts = 5;
    options.cut_tolerance = 0.2;
    Met met;
    run(scene, options, met);
    EXPECT_EQ(met.hashes.size(), 1U) << "decades " << 0.1 * step;
  }
}

TEST(CutTolerance, SavesMessagesAndLosesExactness) {
  const Scene scene = make_scene(Shape::uniform, Weights::none, 3, 20000, false, kToleranceSeed);
  PartitionOptions options;
  options.parts = 16;
  Met exact;
  run(scene, options, exact);
  EXPECT_EQ(exact.error, 0);
  options.cut_tolerance = 0.1;
  Met near;
  run(scene, options, near);
  EXPECT_GT(near.error, 0);
  EXPECT_LE(near.error, 0.1 + 4 / 1250.0);
  EXPECT_LT(near.reductions, exact.reductions);
}

TEST(CutTolerance, FindsTheExactCutWhereTiesLeaveNoOther) {
  const Scene scene = make_scene(Shape::coincident, Weights::none, 3, 5000, true, kToleranceSeed);
  PartitionOptions options;
  options.parts = 7;
  options.cut_tolerance = 0.5;
  Met met;
  run(scene, options, met);
  EXPECT_EQ(met.hashes.size(), 1U);
  EXPECT_LE(met.error, 0.5 + 3 * 7 / 5000.0);
}

// The last bin ends where 31 bits end; a cut behind it would be one behind everything.
TEST(CutTolerance, NothingIsCutBehindTheLastBin) {
  Scene scene;
  scene.dims = 1;
  scene.x[0] = {0, 0, 0};
  while (scene.x[0].size() < 10) scene.x[0].push_back(2 - 0x1p-29);
  for (std::int64_t i = 0; i < 10; ++i) scene.id.push_back(i);
  PartitionOptions options;
  options.parts = 2;
  options.part_sizes = {7, 3};
  options.cut_tolerance = 1;
  options.tuning.gather_max = 1;
  Met met;
  run(scene, options, met);
  EXPECT_EQ(met.hashes.size(), 1U);
  EXPECT_EQ(met.error, 0);
}

}  // namespace
}  // namespace rcb::partition
