// repartition() against partition(): new cuts after a drift are those of a search among all particles, however good or
// bad the guesses were.
#include "common/partition/repartition.hpp"

#include <algorithm>
#include <bit>
#include <mutex>
#include <numeric>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "common/partition/partition.hpp"
#include "tests/support/on_ranks.hpp"
#include "tests/support/ranges_of.hpp"
#include "tests/support/scenes.hpp"
#include "tests/support/self_comm.hpp"

namespace rcb::partition {
namespace {

using namespace testing;

constexpr std::uint64_t kRepartitionSeed = 20260711;

struct Case {
  Scene scene;
  PartitionOptions options;
  double drift = 0;  // of a particle's coordinate, as a share of another particle's distance
  std::uint64_t seed = 0;

  std::string text() const {
    return fmt::format("{}, {} particles, {} parts, method {}, hysteresis {}, drift {}, seed {}", scene.name,
                       scene.count(), options.parts, method_name(options.method), options.axis_hysteresis, drift, seed);
  }
};

// The tree before the drift, and the scene after it.
CutTree drift(Case& trial) {
  std::vector<std::size_t> rows(trial.scene.count());
  std::iota(rows.begin(), rows.end(), std::size_t{0});
  testing::SelfComm self;
  const Share all = testing::take(trial.scene, rows);
  PartitionOptions first = trial.options;
  first.previous = nullptr;
  CutTree tree = partition(self, all.particles.view(), first)->tree;
  Random random(trial.seed);
  for (std::size_t a = 0; a < static_cast<std::size_t>(trial.scene.dims); ++a)
    for (std::size_t i = 0; i < trial.scene.count(); ++i) {
      if (random.below(100) >= static_cast<std::uint64_t>(100 * trial.drift)) continue;
      // Somewhere that occurs, so that ties and decades stay what they are.
      trial.scene.x[a][i] = trial.scene.x[a][random.below(trial.scene.count())];
    }
  return tree;
}

// Every particle on the rank that owns its part, but for one in 23, as after a drift. by_part: part after part, so that
// particles side by side in the arrays are side by side in space.
struct Held {
  Share share;
  std::vector<std::int32_t> part;
};
Held held(const Scene& scene, const CutTree& tree, const comm::Comm& comm, bool by_part = false) {
  const int rank = comm.rank(), ranks = comm.size();
  const auto begin = [&](int r) { return static_cast<int>(std::int64_t{r} * tree.parts / ranks); };
  std::vector<std::int32_t> part;
  std::vector<std::size_t> rows;
  for (std::size_t i = 0; i < scene.count(); ++i) {
    const geometry::Point at{scene.x[0][i], scene.dims > 1 ? scene.x[1][i] : 0, scene.dims > 2 ? scene.x[2][i] : 0};
    const int owner = tree.part_of(at, scene.id[i]);
    const bool stray = i % 23 == 0;
    if (stray ? static_cast<int>(i / 23 % static_cast<std::size_t>(ranks)) == rank
              : owner >= begin(rank) && owner < begin(rank + 1)) {
      rows.push_back(i);
      part.push_back(owner);
    }
  }
  if (by_part) {
    std::vector<std::size_t> order(rows.size());
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::ranges::stable_sort(order, {}, [&part](std::size_t k) { return part[k]; });
    std::vector<std::size_t> sorted;
    for (const std::size_t k : order) sorted.push_back(rows[k]);
    rows = std::move(sorted);
    std::ranges::sort(part);
  }
  return {testing::take(scene, std::move(rows)), std::move(part)};
}

std::string differs(const LoadSummary& a, const LoadSummary& b) {
  if (a.counts != b.counts) return "counts";
  if (a.loads != b.loads || a.scale_exponent != b.scale_exponent || a.weighted != b.weighted) return "loads";
  return a.error == b.error && a.imbalance == b.imbalance ? "" : "error";
}

// How many repartitions were warm, counted by each rank of this process.
std::uint64_t check(Case trial) {
  SCOPED_TRACE(trial.text());
  const CutTree before = drift(trial);
  std::mutex mutex;
  std::uint64_t incremental = 0;
  on_ranks([&](comm::Comm& comm) {
    const auto [share, part] = held(trial.scene, before, comm, trial.seed % 2 == 0);
    const particles::ParticleView view = share.particles.view();
    const particles::BlockRanges blocks = testing::ranges_of(view);
    const auto& sizes = trial.options.part_sizes;
    RepartitionOptions options{trial.options, true, {}};
    options.partition.previous = &before;
    const LoadSummary loads = summarise_loads(comm, view, part, sizes, before.parts);
    const Result<PartitionResult> full = partition(comm, view, options.partition);
    ASSERT_TRUE(full.ok());
    const Repartition got =
        repartition(comm, view, options, {before, part, loads, trial.seed % 3 == 0 ? nullptr : &blocks});
    EXPECT_TRUE(got.tree.cuts == full->tree.cuts);
    EXPECT_EQ(got.tree.hash(), full->tree.hash());
    std::vector<std::int32_t> parts = part;
    for (std::size_t k = 0; k < got.delta.slot.size(); ++k) {
      EXPECT_NE(parts[got.delta.slot[k]], got.delta.part[k]);
      EXPECT_TRUE(k == 0 || got.delta.slot[k - 1] < got.delta.slot[k]);
      parts[got.delta.slot[k]] = got.delta.part[k];
    }
    EXPECT_TRUE(std::equal(parts.begin(), parts.end(), full->part.begin(), full->part.end()));
    EXPECT_EQ(differs(got.loads, summarise_loads(comm, view, parts, sizes, before.parts)), "");
    const std::scoped_lock lock(mutex);
    incremental += got.incremental ? 1U : 0U;
  });
  return incremental;
}

// By how far particles move before the second search, of the scene's width.
class RepartitionAfter : public ::testing::TestWithParam<double> {};
INSTANTIATE_TEST_SUITE_P(Drift, RepartitionAfter, ::testing::Values(0.0, 0.02, 0.3), [](const auto& drift) {
  return drift.param == 0 ? "none" : drift.param < 0.1 ? "little" : "much";
});

TEST_P(RepartitionAfter, GivesTheCutsOfASearchAmongAll) {
  std::uint64_t seed = kRepartitionSeed + std::bit_cast<std::uint64_t>(GetParam());
  std::uint64_t incremental = 0;
  for (int shape = 0; shape < testing::kShapes; ++shape)
    for (int weights = 0; weights < testing::kWeights; ++weights)
      for (const int parts : {1, 2, 5, 8, 16}) {
        ++seed;
        const int dims = 1 + static_cast<int>(mix64(seed) % 3);
        Case trial{make_scene(static_cast<Shape>(shape), static_cast<Weights>(weights), dims, 1 + mix64(seed + 1) % 900,
                              seed % 2 == 0, seed),
                   {},
                   GetParam(),
                   seed};
        trial.options.parts = parts;
        trial.options.axis_hysteresis = seed % 3 == 0 ? 1 : 1.2;
        if (seed % 5 == 0) trial.options.method = Method::bands_x;
        if (seed % 7 == 0)
          for (int p = 0; p < parts; ++p) trial.options.part_sizes.push_back(1 + static_cast<double>(p % 3));
        // From a good guess to none; mostly any number may be looked at.
        trial.options.tuning.bracket_sigmas = static_cast<double>(seed % 4);
        trial.options.tuning.bracket_margin = static_cast<double>(seed % 3);
        trial.options.tuning.boundary_divisor = seed % 4 == 0 ? 5 : 1;
        if (seed % 3 == 0) trial.options.tuning.chunk_max = 1 + seed % 50;
        // Full searches begin with buckets.
        if (seed % 2 == 0)
          trial.options.tuning.sample = {.count_min = 0, .per_part_min = 0, .stride = 1 + seed % 5, .sample_min = 1};
        incremental += check(trial);
        if (HasFailure()) return;
      }
  EXPECT_GT(incremental, 30U);
}

TEST(Repartition, LooksAtFewWhereLittleHasMoved) {
  Case trial{make_scene(Shape::uniform, Weights::none, 3, 40000, false, kRepartitionSeed), {}, 0.01, kRepartitionSeed};
  trial.options.parts = 4;
  trial.options.axis_hysteresis = 1.5;
  const CutTree before = drift(trial);
  on_ranks([&](comm::Comm& comm) {
    const auto [share, part] = held(trial.scene, before, comm);
    RepartitionOptions options{trial.options, true, {}};
    options.partition.previous = &before;
    const LoadSummary loads = summarise_loads(comm, share.particles.view(), part, {}, 4);
    const Repartition got = repartition(comm, share.particles.view(), options, {before, part, loads});
    EXPECT_TRUE(got.incremental);
    EXPECT_LT(got.cost.searched, trial.scene.count() / 5);
    EXPECT_EQ(got.loads.error, 0);
    options.incremental = false;
    const Repartition full = repartition(comm, share.particles.view(), options, {before, part, loads});
    EXPECT_FALSE(full.incremental);
    EXPECT_EQ(full.cost.searched, trial.scene.count());
    EXPECT_EQ(full.tree.hash(), got.tree.hash());
  });
}

}  // namespace
}  // namespace rcb::partition
