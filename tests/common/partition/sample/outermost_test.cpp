// The outermost particles against brute force: with them the boxes of a sample are those of all particles.
#include "common/partition/sample/outermost.hpp"

#include <gtest/gtest.h>

#include "common/base/index.hpp"
#include "common/base/random.hpp"
#include "tests/support/self_comm.hpp"

namespace rcb::partition {
namespace {

// Uniform in a box of these extents.
particles::ParticleSet uniform(std::size_t count, const Point& extents, int dims) {
  particles::ParticleSet set;
  set.dims = dims;
  set.resize(count);
  Random random(20261127);
  for (std::size_t i = 0; i < count; ++i) {
    set.id[i] = static_cast<Id>(i);
    for (std::size_t a = 0; a < at(dims); ++a) set.position[a][i] = random.uniform() * extents[a];
  }
  return set;
}

constexpr std::uint64_t kStride = 16;

// With the outermost particles, if they are gathered; tells whether they are.
bool gathered(const particles::ParticleSet& set, const PartitionOptions& options, std::uint64_t stride = kStride) {
  testing::SelfComm self;
  const particles::ParticleView particles = set.view();
  const Sample sample = gather_sample(self, particles, sampled_slots(particles.count, kStride));
  SortedSample sorted(sample);
  const AxisOrder axes = geometry::order_by_extent(sorted.extents(sorted.all()), particles.dims);
  SearchCost spent;
  gather_outermost_if_open(self, particles, options, stride, sorted, spent);
  const bool are = spent.reads > 0;
  EXPECT_EQ(are, spent.reductions == 2);  // rank 0 says that it is needed; the gather
  if (!are) return false;

  geometry::Box all;
  for (std::size_t i = 0; i < particles.count; ++i) all.extend(particles.point(i), particles.dims);
  const geometry::Box of_sample = sorted.box(sorted.all());
  const auto axis = at(axes[0]);
  const auto left = static_cast<std::size_t>(0.5 * static_cast<double>(sample.count()));
  const double cut = sorted.x(sorted.all(), axis, left);
  const SortedSample::Halves halves = sorted.split(sorted.all(), axis, left);
  geometry::Box lower;
  geometry::Box upper;
  for (std::size_t i = 0; i < particles.count; ++i)
    (particles.position[axis][i] < cut ? lower : upper).extend(particles.point(i), particles.dims);
  const geometry::Box of_lower = sorted.box(halves.left);
  const geometry::Box of_upper = sorted.box(halves.right);
  for (std::size_t a = 0; a < at(particles.dims); ++a) {
    EXPECT_EQ(of_sample.lo[a], all.lo[a]);
    EXPECT_EQ(of_sample.hi[a], all.hi[a]);
    EXPECT_EQ(of_lower.lo[a], lower.lo[a]);
    EXPECT_EQ(of_upper.hi[a], upper.hi[a]);
    if (a == axis) continue;  // the other faces lie at the cut
    EXPECT_EQ(of_lower.hi[a], lower.hi[a]);
    EXPECT_EQ(of_upper.lo[a], upper.lo[a]);
  }
  return true;
}

TEST(Outermost, MakeBoxesExactWhereTheLongestAxisIsOpen) {
  PartitionOptions options;
  options.parts = 64;
  for (const int dims : {2, 3})
    for (const std::size_t count : {1000U, 20'000U, 20'001U}) {
      EXPECT_TRUE(gathered(uniform(count, {1, 1, 1}, dims), options));
      EXPECT_FALSE(gathered(uniform(count, {8, 1, 1}, dims), options)) << "the others don't matter";
    }
  EXPECT_FALSE(gathered(uniform(1000, {1, 1, 1}, 1), options)) << "there is one axis";
}

TEST(Outermost, AreLeftWhereTheyDecideNothingOrWouldBeMany) {
  const particles::ParticleSet cube = uniform(20'000, {1, 1, 1}, 3);
  PartitionOptions options;
  options.parts = 64;
  EXPECT_FALSE(gathered(cube, options, std::uint64_t{1} << 20U)) << "too many";
  options.method = Method::bands_x;
  EXPECT_FALSE(gathered(cube, options));
  options.method = Method::rcb;
  const CutTree previous;
  options.previous = &previous;
  options.axis_hysteresis = 1.2;
  EXPECT_FALSE(gathered(cube, options));
  options.axis_hysteresis = 1;
  EXPECT_TRUE(gathered(cube, options));
}

}  // namespace
}  // namespace rcb::partition
