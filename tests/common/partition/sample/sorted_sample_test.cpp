// A sorted sample keeps its order on every axis, however it is divided.
#include "common/partition/sample/sorted_sample.hpp"

#include <algorithm>
#include <numeric>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "tests/support/scenes.hpp"
#include "tests/support/self_comm.hpp"

namespace rcb::partition {
namespace {

using namespace testing;

struct Set {
  Share all;
  Sample sample;
  std::string name;
};

Set any_set(Random& random) {
  const auto dims = static_cast<int>(1 + random.below(3));
  const std::uint64_t count = 1 + random.below(random.below(2) == 0 ? 100 : 2000);
  const Scene scene = make_scene(static_cast<Shape>(random.below(kShapes)), Weights::none, dims, count,
                                 random.below(2) == 0, random.below(1U << 30U));
  std::vector<std::size_t> rows(scene.count());
  std::iota(rows.begin(), rows.end(), std::size_t{0});
  Set set{testing::take(scene, rows), {}, fmt::format("{}, {} dimensions, {} particles", scene.name, dims, count)};
  testing::SelfComm self;
  set.sample = gather_sample(self, set.all.particles.view(), sampled_slots(scene.count(), 1 + random.below(8)));
  return set;
}

TEST(SortedSample, KeepsEveryAxisInOrderWhereItIsDivided) {
  Random random(20261128);
  for (int round = 0; round < 300; ++round) {
    const Set set = any_set(random);
    SCOPED_TRACE(set.name);
    const std::size_t dims = at(set.sample.dims);
    SortedSample sorted(set.sample);
    std::vector<SortedSample::Range> ranges{sorted.all()};
    for (int cut = 0; cut < 6; ++cut) {
      const std::size_t axis = random.below(dims);
      const SortedSample::Range own = ranges[random.below(ranges.size())];
      const std::size_t left = random.below(own.size() + 1);
      std::erase_if(ranges, [&](const auto& range) { return range.first == own.first && range.last == own.last; });
      const auto [lower, upper] = sorted.split(own, axis, left);
      ranges.insert(ranges.end(), {lower, upper});
      EXPECT_EQ(lower.size(), left);
      EXPECT_EQ(lower.first, own.first);
      EXPECT_EQ(lower.last, upper.first);
      EXPECT_EQ(upper.last, own.last);
      if (left > 0 && left < own.size()) {
        const double below = sorted.x(lower, axis, left - 1);
        const double above = sorted.x(upper, axis, 0);
        EXPECT_LE(below, above);
        EXPECT_LT(sorted.below(lower, axis, below), left);
        EXPECT_EQ(sorted.below(upper, axis, above), 0U);
      }
    }
    for (std::size_t a = 0; a < dims; ++a) {
      std::vector<double> all;
      for (const SortedSample::Range& range : ranges)
        for (std::size_t k = 0; k < range.size(); ++k) {
          all.push_back(sorted.x(range, a, k));
          if (k == 0) continue;
          EXPECT_LE(sorted.x(range, a, k - 1), all.back());
        }
      std::vector<double> sampled(set.sample.position[a].begin(), set.sample.position[a].end());
      std::ranges::sort(all);
      std::ranges::sort(sampled);
      EXPECT_EQ(all, sampled);
    }
  }
}

}  // namespace
}  // namespace rcb::partition
