// classify_guessed() against the definition: what it takes for interior is so by the whole keys, and its counts, boxes
// and boundary particles are those of the parts that it writes.
#include "common/partition/incremental/classify_guessed.hpp"

#include <algorithm>
#include <numeric>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "common/base/index.hpp"
#include "common/comm/self_comm.hpp"
#include "common/partition/partition.hpp"
#include "common/partition/search/build_tree.hpp"
#include "tests/support/scenes.hpp"

namespace rcb::partition {
namespace {

using namespace testing;

// The first part below the node where the guess ends, or -1 for a particle in a bracket.
int interior_part(const Guess& guess, NodeRange range, const particles::ParticleView& particles, std::size_t i) {
  while (!range.leaf() && guess.brackets[at(range.node)].known) {
    const KeyBracket& bracket = guess.brackets[at(range.node)];
    const Key key = key_of(particles.point(i), particles.id[i], bracket.axes, particles.dims);
    const bool left = bracket.whole ? key < bracket.least : key.at[0] < bracket.least.at[0];
    const bool right = bracket.whole ? bracket.most < key : key.at[0] > bracket.most.at[0];
    if (!left && !right) return -1;
    range = left ? range.left() : range.right();
  }
  return range.first;
}

struct Trial {
  Scene scene;
  PartitionOptions options;
  std::uint64_t stride = 1;
  bool below_roots = false;
  bool sorted = false;
};

void check(const Trial& trial, std::uint64_t& interior) {
  std::vector<std::size_t> rows(trial.scene.count());
  std::iota(rows.begin(), rows.end(), std::size_t{0});
  // So that whole blocks lie in a bracket.
  if (trial.sorted) std::ranges::sort(rows, {}, [&](std::size_t row) { return trial.scene.x[0][row]; });
  const Share all = testing::take(trial.scene, rows);
  const particles::ParticleView particles = all.particles.view();
  comm::SelfComm self;
  CutTree tree = uncut_tree(trial.options, particles.dims);
  const NodeRange root = tree.root();
  std::vector<NodeRange> roots{root};
  std::vector<std::int32_t> part(particles.count, -1);  // of no meaning where the whole tree is guessed
  if (trial.below_roots) {
    tree = partition(self, particles, trial.options)->tree;
    tree.classify(particles, part);
    roots = {root.left().left(), root.right()};
    // Any part of its root will do.
    for (std::int32_t& own : part)
      for (const NodeRange& r : roots)
        if (own >= r.first && own < r.last) own = r.first;
  }
  const std::vector<std::int32_t> before = part;
  const Sample sample =
      share_sample(self, particles, pick(particles.count, trial.stride), {.weights = true, .ids = true});
  const Guess guess =
      guess_cuts(SortedSample(sample), trial.options, {tree, roots, {}, SplitRule(trial.options, particles.dims)});
  if (!guess.found) return;
  if (trial.stride == 1 && !trial.below_roots) {  // a sample of all tells the root's cut
    const Cut root_cut = partition(self, particles, trial.options)->tree.cuts[0];
    const Key& cut = root_cut.key;
    const KeyBracket& bracket = guess.brackets[0];
    if (root_cut.axes == bracket.axes) {
      EXPECT_LE(bracket.least.at[0], cut.at[0]) << trial.scene.name;
      EXPECT_LE(cut.at[0], bracket.most.at[0]) << trial.scene.name;
      if (bracket.whole) {
        EXPECT_FALSE(cut < bracket.least || bracket.most < cut) << trial.scene.name;
      }
    }
  }
  const OwnInterior own = classify_guessed(particles, guess, roots, part, particles.count);
  ASSERT_FALSE(own.too_many);

  std::vector<std::uint64_t> counts(at(trial.options.parts), 0);
  auto boxes = guess.seen;
  ASSERT_TRUE(std::ranges::is_sorted(own.slot.span()));
  std::size_t k = 0;
  for (std::size_t i = 0; i < particles.count; ++i) {
    SCOPED_TRACE(fmt::format("{}, {} dimensions, {} particles, particle {}", trial.scene.name, particles.dims,
                             particles.count, i));
    ++counts[at(part[i])];
    const auto own_root =
        std::ranges::find_if(roots, [&](const NodeRange& r) { return !trial.below_roots || before[i] == r.first; });
    if (k < own.slot.size() && own.slot[k] == i) {
      ASSERT_NE(own_root, roots.end()) << "no particle outside of the roots is searched";
      EXPECT_EQ(own.part[k], part[i]);
      for (std::size_t a = 0; a < at(particles.dims); ++a)
        EXPECT_EQ(own.boundary.position[a][k], particles.position[a][i]);
      ++k;
      EXPECT_TRUE(part[i] >= own_root->first && part[i] < own_root->last);
    } else if (own_root == roots.end()) {
      EXPECT_EQ(part[i], before[i]);
    } else {
      ASSERT_EQ(part[i], interior_part(guess, *own_root, particles, i));
      boxes[at(part[i])].extend(particles.point(i), particles.dims);
      ++interior;
    }
  }
  EXPECT_EQ(k, own.slot.size()) << "each slot is listed once";
  EXPECT_EQ(own.counts, counts);
  for (const NodeRange& r : roots)
    for (std::size_t p = at(r.first); p < at(r.last); ++p)
      for (std::size_t a = 0; a < at(particles.dims); ++a) {
        EXPECT_EQ(own.boxes[p].lo[a], boxes[p].lo[a]) << trial.scene.name << ", part " << p;
        EXPECT_EQ(own.boxes[p].hi[a], boxes[p].hi[a]) << trial.scene.name << ", part " << p;
      }
}

TEST(ClassifyGuessed, GivesWhatTheKeysTell) {
  std::uint64_t interior = 0;
  Random random(20261126);
  for (int round = 0; round < 1500 && !HasFatalFailure(); ++round) {
    Trial trial;
    const auto dims = static_cast<int>(1 + random.below(3));
    const std::uint64_t count = 1 + random.below(random.below(2) == 0 ? 200 : 2000);
    trial.scene = make_scene(static_cast<Shape>(random.below(kShapes)), Weights::none, dims, count,
                             random.below(2) == 0, random.below(1U << 30U));
    trial.options.parts = static_cast<int>(4 + random.below(5));
    trial.options.limits.bracket_sigmas = static_cast<double>(random.below(3));
    trial.options.limits.guess.tied_max = std::array{0.0, 0.03, 1.0}.at(random.below(3));
    trial.options.limits.guess.boundary_max = 1;
    trial.options.limits.guess.levels_min = 0;
    trial.options.limits.guess.overhang = 0;
    trial.stride = 1 + random.below(8);
    trial.sorted = random.below(2) == 0;
    trial.below_roots = random.below(3) == 0;
    check(trial, interior);
  }
  EXPECT_GT(interior, 100'000U) << "hardly anything was checked";
}

}  // namespace
}  // namespace rcb::partition
