// Divided samples against a sort by whole keys.
#include "common/partition/sample/sample.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "common/base/index.hpp"
#include "tests/support/scenes.hpp"
#include "tests/support/self_comm.hpp"

namespace rcb::partition {
namespace {

using namespace testing;

TEST(Sample, IsDividedByKeysAndBracketsTheCut) {
  Random random(20261128);
  for (int round = 0; round < 500; ++round) {
    const auto dims = static_cast<int>(1 + random.below(3));
    const std::uint64_t count = random.below(random.below(2) == 0 ? 20 : 2000);
    const Scene scene = make_scene(static_cast<Shape>(random.below(kShapes)), Weights::none, dims, count,
                                   random.below(2) == 0, random.below(1U << 30U));
    SCOPED_TRACE(fmt::format("{}, {} dimensions, {} particles", scene.name, dims, count));
    std::vector<std::size_t> rows(scene.count());
    std::iota(rows.begin(), rows.end(), std::size_t{0});
    const Share all = testing::take(scene, rows);
    testing::SelfComm self;
    const auto slots = sampled_slots(scene.count(), 1 + random.below(8));
    Buffer<SampledParticle> sample = gather_sample(self, all.particles.view(), slots);
    ASSERT_EQ(sample.size(), slots.size());
    SampledCut cut{.axes = geometry::with_first({0, 1, 2}, static_cast<int>(random.below(at(dims))), dims)};
    const auto key = [&](const SampledParticle& own) { return cuts::key_of(own.x, 0, cut.axes, dims); };
    std::vector<cuts::Key> sorted;
    for (const SampledParticle& own : sample) sorted.push_back(key(own));
    std::sort(sorted.begin(), sorted.end());
    Tuning tuning;
    tuning.bracket_sigmas = static_cast<double>(random.below(3));
    tuning.bracket_margin = static_cast<double>(random.below(3));
    cut.below = random.uniform(-5, static_cast<double>(sample.size()) + 5);
    cut.deviation = random.uniform(0, 20);
    const auto [left, right, bracket] = divide_sample(sample.span(), cut, tuning);

    EXPECT_EQ(left.size() + right.size(), sample.size());
    EXPECT_EQ(left.data(), sample.data());
    EXPECT_EQ(static_cast<double>(left.size()),
              std::floor(std::clamp(cut.below, 0.0, static_cast<double>(sample.size()))));
    for (std::size_t k = 0; k < sample.size(); ++k) {
      const bool in_order =
          k < left.size() ? !(sorted[left.size() - 1] < key(sample[k])) : !(key(sample[k]) < sorted[left.size()]);
      EXPECT_TRUE(in_order);
    }
    const auto end_at = [&](double k) {
      if (sample.empty() || k < 0) return -geometry::Box::kInfinity;
      return k < static_cast<double>(sorted.size()) ? sorted[static_cast<std::size_t>(k)].at[0]
                                                    : geometry::Box::kInfinity;
    };
    const double half_width = tuning.bracket_sigmas * cut.deviation + tuning.bracket_margin;
    EXPECT_EQ(bracket.least, end_at(std::floor(cut.below - half_width)));
    EXPECT_EQ(bracket.most, sample.empty() ? geometry::Box::kInfinity : end_at(std::ceil(cut.below + half_width)));
    std::vector<cuts::Key> kept;
    for (const SampledParticle& own : sample) kept.push_back(key(own));
    std::sort(kept.begin(), kept.end());
    EXPECT_TRUE(kept == sorted);
  }
}

}  // namespace
}  // namespace rcb::partition
