// A guide from the cuts in force against the new cuts.
#include "common/partition/sample/guide.hpp"

#include <algorithm>
#include <mutex>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "common/base/index.hpp"
#include "tests/common/partition/sample/guides.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::partition {
namespace {

using namespace testing;

constexpr std::uint64_t kFromCutsSeed = 20261130;

int part_in(const CutTree& tree, const Scene& scene, std::size_t row) {
  const Point point{scene.x[0][row], scene.dims > 1 ? scene.x[1][row] : 0, scene.dims > 2 ? scene.x[2][row] : 0};
  return tree.part_of(point, scene.id[row]);
}

// The inner regions of the tree's parts, by its upper cuts alone.
void upper_regions(const CutTree& tree, const Splitters& splitters, const NodeRange& range, std::size_t heap,
                   const geometry::Box& box, std::vector<geometry::Box>& found) {
  if (range.leaf() || heap >= Splitters::kNodes) {
    std::fill(found.begin() + range.first, found.begin() + range.last, box);
    return;
  }
  const auto axis = at(tree.cuts[at(range.node)].axes[0]);
  geometry::Box left = box;
  geometry::Box right = box;
  left.hi[axis] = std::min(left.hi[axis], splitters.nodes[heap].least);
  right.lo[axis] = std::max(right.lo[axis], splitters.nodes[heap].most);
  upper_regions(tree, splitters, range.left(), 2 * heap + 1, left, found);
  upper_regions(tree, splitters, range.right(), 2 * heap + 2, right, found);
}

bool strictly_inside(const geometry::Box& box, const Scene& scene, std::size_t row) {
  bool inside = true;
  for (std::size_t a = 0; a < at(scene.dims); ++a)
    inside = inside && scene.x[a][row] > box.lo[a] && scene.x[a][row] < box.hi[a];
  return inside;
}

struct Told {
  Hits hits;
  std::uint64_t particles = 0;
  std::uint64_t inner = 0;  // strictly inside the inner region of the part that they have
  std::uint64_t left = 0;   // of those, how many get another part
};

void check_guide(Scene scene, int parts, double drift, Told& told) {
  SCOPED_TRACE(fmt::format("{}, {} parts, drift {}", scene.name, parts, drift));
  PartitionOptions options;
  options.parts = parts;
  const CutTree before = tree_of(scene, options);
  Random random(kFromCutsSeed);
  const std::vector<double> old_x = scene.x[0];
  for (std::size_t a = 0; a < at(scene.dims) && scene.count() > 0; ++a) {
    const auto [least, most] = std::ranges::minmax(scene.x[a]);
    // One side moves more than the other, so that loads change.
    for (std::size_t i = 0; i < scene.count(); ++i)
      scene.x[a][i] += drift * (most * 0.5 - least * 0.5) * random.uniform(-0.5, old_x[i] > 0.5 ? 1 : 0.5);
  }
  options.previous = &before;
  options.axis_hysteresis = 3;  // no axis flips
  const CutTree after = tree_of(scene, options);
  const std::uint64_t count = scene.count();
  std::mutex mutex;
  on_ranks([&](comm::Comm& comm) {
    const Share share = deal(scene, comm.rank(), comm.size(), kFromCutsSeed);
    const particles::ParticleView view = share.particles.view();
    std::vector<std::int32_t> part;
    for (const std::size_t row : share.row) part.push_back(part_in(before, scene, row));
    const LoadSummary loads = summarise_loads(comm, view, part, {}, parts);
    SearchCost cost;
    const GuideFromCuts found =
        guide_from_cuts(comm, view, {.tree = before, .part = part, .loads = loads}, count, options, cost);
    EXPECT_TRUE(found.guide.split);
    EXPECT_EQ(cost.reductions, 2U);
    EXPECT_TRUE(same_on_all_ranks(comm, numbers_of(found.guide)));
    EXPECT_EQ(found.inner.size(), at(parts));
    std::vector<geometry::Box> upper(at(parts));
    upper_regions(before, found.guide.splitters, before.root(), 0, geometry::Box::unbounded(), upper);
    const std::scoped_lock lock(mutex);
    told.hits.count(after, found.guide.splitters, after.root(), 0);
    expect_leaves_left(found.guide.splitters, before.root(), 0);
    for (int p = 0; p < parts; ++p) {
      const geometry::Box& inner = found.inner[at(p)];
      if (inner.empty(scene.dims)) continue;
      for (std::size_t a = 0; a < at(scene.dims); ++a) {
        EXPECT_GE(inner.lo[a], upper[at(p)].lo[a]);
        EXPECT_LE(inner.hi[a], upper[at(p)].hi[a]);
        if (at(parts) > Splitters::kNodes + 1) continue;
        EXPECT_EQ(inner.lo[a], upper[at(p)].lo[a]);
        EXPECT_EQ(inner.hi[a], upper[at(p)].hi[a]);
      }
    }
    for (std::size_t row = 0; row < count; ++row) {
      const int p = part_in(before, scene, row);
      ++told.particles;
      if (!strictly_inside(found.inner[at(p)], scene, row)) continue;
      ++told.inner;
      told.left += part_in(after, scene, row) == p ? 0U : 1U;
    }
  });
}

TEST(GuideFromCuts, BracketsTheNewCutsAndKnowsWhoStays) {
  Told few;
  Told many;
  for (const Shape shape : {Shape::uniform, Shape::clusters})
    for (const double drift : {0.0, 0.001, 0.02}) {
      const Scene scene = make_scene(shape, Weights::none, 3, 20'000, false, kFromCutsSeed);
      check_guide(scene, 5, drift, few);
      check_guide(scene, 64, drift, many);
      check_guide(scene, 200, drift, many);
    }
  EXPECT_GT(few.hits.nodes + many.hits.nodes, 500);
  EXPECT_GT(few.hits.bracketed + many.hits.bracketed, 0.97 * (few.hits.nodes + many.hits.nodes));
  EXPECT_EQ(few.hits.unbounded, 0);
  EXPECT_GT(static_cast<double>(few.inner), 0.8 * static_cast<double>(few.particles));
  EXPECT_GT(static_cast<double>(many.inner), 0.3 * static_cast<double>(many.particles));
  EXPECT_LT(static_cast<double>(few.left + many.left), 0.005 * static_cast<double>(few.inner + many.inner));
}

TEST(GuideFromCuts, IsMadeForEveryScene) {
  Told told;
  for (int shape = 0; shape < kShapes; ++shape)
    for (const std::size_t count : {0U, 1U, 3U, 500U}) {
      const Scene scene =
          make_scene(static_cast<Shape>(shape), Weights::none, 1 + shape % 3, count, false, kFromCutsSeed);
      check_guide(scene, 1 + shape * 9, 0, told);
    }
}

}  // namespace
}  // namespace rcb::partition
