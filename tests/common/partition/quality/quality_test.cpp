// Quality against a judge that looks at every pair of part and particle; interfaces against known figures.
#include "common/partition/quality/quality.hpp"

#include <cmath>
#include <limits>
#include <numeric>
#include <set>

#include <gtest/gtest.h>

#include "common/partition/partition.hpp"
#include "tests/support/on_ranks.hpp"
#include "tests/support/scenes.hpp"

namespace rcb::partition {
namespace {

using namespace testing;

constexpr std::uint64_t kQualitySeed = 99;

struct Expected {
  std::vector<std::uint64_t> ghosts;
  std::vector<std::int32_t> neighbours;
};

Expected by_all_pairs(const Scene& scene, const std::vector<std::int32_t>& part, int parts, double width) {
  Expected expected;
  const auto dims = static_cast<std::size_t>(scene.dims);
  for (int p = 0; p < parts; ++p) {
    std::set<std::int32_t> owners;
    std::uint64_t ghosts = 0;
    std::array<double, 3> lo{};
    std::array<double, 3> hi{};
    bool any = false;
    for (std::size_t i = 0; i < scene.count(); ++i) {
      if (part[i] != p) continue;
      for (std::size_t a = 0; a < dims; ++a) {
        lo[a] = any ? std::min(lo[a], scene.x[a][i]) : scene.x[a][i];
        hi[a] = any ? std::max(hi[a], scene.x[a][i]) : scene.x[a][i];
      }
      any = true;
    }
    for (std::size_t i = 0; any && i < scene.count(); ++i) {
      double distance = 0;
      for (std::size_t a = 0; a < dims; ++a)
        distance = std::max({distance, lo[a] - scene.x[a][i], scene.x[a][i] - hi[a]});
      if (part[i] == p || distance > width) continue;
      ++ghosts;
      owners.insert(part[i]);
    }
    expected.ghosts.push_back(ghosts);
    expected.neighbours.push_back(static_cast<std::int32_t>(owners.size()));
  }
  return expected;
}

Quality quality_of(comm::Comm& comm, const particles::ParticleView& particles, std::span<const std::int32_t> part,
                   int parts, const CutTree* tree, std::optional<double> width) {
  return *quality(comm, particles, part, parts, tree, width, [] { return true; });
}

void check(const Scene& scene, int parts, std::optional<double> width, bool by_cuts) {
  SCOPED_TRACE(scene.name);
  PartitionOptions options;
  options.parts = parts;
  on_ranks([&](comm::Comm& comm) {
    // The owner of every row, on every rank.
    const Share all = deal(scene, 0, 1, kQualitySeed);
    const Share share = deal(scene, comm.rank(), comm.size(), kQualitySeed);
    const CutTree tree = partition(comm, share.particles.view(), options).value().tree;
    std::vector<std::int32_t> part_of_row(scene.count());
    for (std::size_t i = 0; i < scene.count(); ++i) {
      const std::size_t row = all.row[i];
      part_of_row[row] = by_cuts ? tree.part_of(all.particles.view().point(i), all.particles.id[i])
                                 : static_cast<std::int32_t>(mix64(row) % static_cast<std::uint64_t>(parts));
    }
    std::vector<std::int32_t> part;
    for (const std::size_t row : share.row) part.push_back(part_of_row[row]);
    const Quality got = quality_of(comm, share.particles.view(), part, parts, by_cuts ? &tree : nullptr, width);
    EXPECT_EQ(got.interface_area.has_value(), by_cuts);
    EXPECT_EQ(got.ghost_width, width.value_or(got.ghost_width));
    const Expected expected = by_all_pairs(scene, part_of_row, parts, got.ghost_width);
    EXPECT_EQ(got.ghosts, expected.ghosts);
    EXPECT_EQ(got.neighbours, expected.neighbours);
    if (by_cuts && std::isfinite(2 * *got.interface_area)) {
      const double sum = std::accumulate(got.part_interface_area.begin(), got.part_interface_area.end(), 0.0);
      EXPECT_NEAR(sum, 2 * *got.interface_area, 1e-9 * sum);
    }
  });
}

TEST(Quality, AgreesWithAllPairs) {
  for (int shape = 0; shape < testing::kShapes; ++shape)
    for (const int parts : {1, 2, 7, 30})
      for (const bool by_cuts : {true, false})
        check(make_scene(static_cast<Shape>(shape), Weights::none, 1 + (shape + parts) % 3, 120, false,
                         kQualitySeed + static_cast<std::uint64_t>(shape)),
              parts, std::nullopt, by_cuts);
  check(make_scene(Shape::lattice, Weights::none, 3, 120, false, kQualitySeed), 8, 0.0, true);
  check(make_scene(Shape::lattice, Weights::none, 3, 120, false, kQualitySeed), 8, 1.0, true);
  for (const double width : {0.1, 0.4, 1.0, 1e300, std::numeric_limits<double>::max()})
    for (const int parts : {2, 7, 30, 200})
      check(make_scene(Shape::uniform, Weights::none, 3, 150, false, kQualitySeed), parts, width, parts != 7);
  check(make_scene(Shape::uniform, Weights::none, 2, 3, false, kQualitySeed), 8, std::nullopt, true);
  check(make_scene(Shape::uniform, Weights::none, 2, 0, false, kQualitySeed), 8, std::nullopt, true);
}

// In rounds however short, and with as little memory as there can be, the counts are the same; between rounds it is
// asked whether to go on.
TEST(Ghosts, AreCountedInRoundsThatCanBeGivenUp) {
  const Scene scene = make_scene(Shape::uniform, Weights::none, 3, 400, false, kQualitySeed);
  constexpr int kParts = 40;
  on_ranks([&](comm::Comm& comm) {
    const Share share = deal(scene, comm.rank(), comm.size(), kQualitySeed);
    std::vector<std::int32_t> part;
    for (const std::size_t row : share.row) part.push_back(static_cast<std::int32_t>(mix64(row) % kParts));
    std::vector<std::int32_t> part_of_row(scene.count());
    for (std::size_t row = 0; row < scene.count(); ++row)
      part_of_row[row] = static_cast<std::int32_t>(mix64(row) % kParts);
    for (const double width : {0.0, 0.02, 10.0}) {
      const Expected expected = by_all_pairs(scene, part_of_row, kParts, width);
      int asked = 0;
      const GhostLimits limits{.round_visits = 1, .pending_max = 1};
      const auto counts = count_ghosts(
          comm, share.particles.view(), part, part_boxes(comm, share.particles.view(), part, kParts), width,
          [&] { return ++asked > 0; }, limits);
      ASSERT_TRUE(counts);
      EXPECT_EQ(counts->ghosts, expected.ghosts);
      EXPECT_EQ(counts->neighbours, expected.neighbours);
      EXPECT_GE(asked, static_cast<int>(scene.count()) / comm.size());
      int left = 5;
      EXPECT_FALSE(count_ghosts(
          comm, share.particles.view(), part, part_boxes(comm, share.particles.view(), part, kParts), width,
          [&] { return --left > 0; }, limits));
      EXPECT_EQ(left, 0);
    }
  });
}

// Where all is near everything, the work is in proportion to the particles, not to the particles times the parts.
TEST(Ghosts, OfAnyWidthCostNoMore) {
  const Scene scene = make_scene(Shape::uniform, Weights::none, 3, 20000, false, kQualitySeed);
  constexpr int kParts = 16000;
  on_ranks([&](comm::Comm& comm) {
    const Share share = deal(scene, comm.rank(), comm.size(), kQualitySeed);
    std::vector<std::int32_t> part;
    for (const std::size_t row : share.row) part.push_back(static_cast<std::int32_t>(row % kParts));
    int rounds = 0;
    const auto counts =
        count_ghosts(comm, share.particles.view(), part, part_boxes(comm, share.particles.view(), part, kParts), 1e300,
                     [&] { return ++rounds > 0; }, {.round_visits = 20000});
    ASSERT_TRUE(counts);
    EXPECT_LE(rounds, 3);
    std::vector<std::uint64_t> all_but_own(kParts, 20000 - 1);
    std::fill_n(all_but_own.begin(), 20000 - kParts, 20000 - 2);  // these parts have two
    EXPECT_EQ(counts->ghosts, all_but_own);
    EXPECT_EQ(counts->neighbours, std::vector<std::int32_t>(kParts, kParts - 1));
  });
}

// A box of 4 x 3 x 1 with the corners taken, halved across x, then y in each half.
TEST(Quality, InterfaceOfAKnownBox) {
  on_ranks([](comm::Comm& comm) {
    particles::ParticleSet set;
    if (comm.rank() == 0) {
      set.resize(16);
      for (std::size_t i = 0; i < 16; ++i) {
        set.position[0][i] = std::array<double, 4>{0, 1, 3, 4}[i % 4];
        set.position[1][i] = (i / 4) % 2 == 0 ? 0 : 3;
        set.position[2][i] = i < 8 ? 0 : 1;
        set.id[i] = static_cast<Id>(i);
      }
    }
    PartitionOptions options;
    options.method = Method::equal_boxes;
    options.parts = 4;
    const PartitionResult got = partition(comm, set.view(), options).value();
    const Quality result = quality_of(comm, set.view(), got.part.span(), 4, &got.tree, 0.5);
    EXPECT_EQ(*result.interface_area, 3 + 2 * 2);  // 3 x 1 across x, twice 2 x 1 across y
    EXPECT_EQ(result.part_interface_area, (std::vector<double>{3.5, 3.5, 3.5, 3.5}));
    EXPECT_EQ(result.ghosts, (std::vector<std::uint64_t>{0, 0, 0, 0}));
    EXPECT_EQ(default_ghost_width(result.bounds, 12, 3), 2.0);
  });
}

// Points in a plane of 3-D space: the flat axis has no length for areas, but is none for the default width.
TEST(Quality, OfAFlatSet) {
  on_ranks([](comm::Comm& comm) {
    particles::ParticleSet set;
    if (comm.rank() == 0) {
      set.resize(16);
      for (std::size_t i = 0; i < 16; ++i) {
        set.position[0][i] = static_cast<double>(i % 4);
        set.position[1][i] = static_cast<double>(i / 4);
        set.position[2][i] = 7;
        set.id[i] = static_cast<Id>(i);
      }
    }
    PartitionOptions options;
    options.parts = 2;
    for (const Method method : {Method::rcb, Method::bands_z}) {
      options.method = method;
      const PartitionResult got = partition(comm, set.view(), options).value();
      const Quality result = quality_of(comm, set.view(), got.part.span(), 2, &got.tree, std::nullopt);
      EXPECT_EQ(result.ghost_width, 2 * std::sqrt(9 / 16.0));
      const double area = method == Method::rcb ? 0 : 9;  // a cut across the flat axis has the set's own area
      EXPECT_EQ(*result.interface_area, area);
      EXPECT_EQ(result.part_interface_area, (std::vector<double>{area, area}));
      EXPECT_EQ(result.ghosts, (std::vector<std::uint64_t>{4, 4})) << method_name(method);
      EXPECT_EQ(result.neighbours, (std::vector<std::int32_t>{1, 1}));
    }
  });
}

// Areas, and sums of areas, beyond what a double holds are the greatest there is, and no NaN or infinity.
TEST(Quality, AreasBeyondADouble) {
  for (const double far : {1.7e308, 6e153})  // of 6e153 each face fits, two together don't
    on_ranks([far](comm::Comm& comm) {
      particles::ParticleSet set;
      if (comm.rank() == 0) {
        set.resize(6);
        for (std::size_t i = 0; i < 6; ++i) {
          for (std::size_t a = 0; a < 3; ++a) set.position[a][i] = far / 3 * (static_cast<double>(i) - 3);
          set.id[i] = static_cast<Id>(i);
        }
      }
      PartitionOptions options;
      options.method = Method::bands_x;
      options.parts = 6;
      const PartitionResult got = partition(comm, set.view(), options).value();
      const Quality result = quality_of(comm, set.view(), got.part.span(), 6, &got.tree, 0.5);
      const double greatest = std::numeric_limits<double>::max();
      EXPECT_EQ(*result.interface_area, greatest);
      EXPECT_EQ(result.part_interface_area[1], greatest);
      for (const double area : result.part_interface_area) EXPECT_TRUE(std::isfinite(area) && area > 0);
    });
}

TEST(Quality, DefaultWidth) {
  geometry::Box box{{0, 0, 0}, {10, 10, 0}};
  EXPECT_DOUBLE_EQ(default_ghost_width(box, 100, 3), 2);  // the flat axis does not count
  EXPECT_EQ(default_ghost_width(box, 0, 3), 0);
  EXPECT_EQ(default_ghost_width({{1, 1, 1}, {1, 1, 1}}, 5, 3), 0);
  box = {{-1.7e308, -1.7e308, -1.7e308}, {1.7e308, 1.7e308, 1.7e308}};
  EXPECT_TRUE(std::isfinite(default_ghost_width(box, 5, 3)));
  EXPECT_GT(default_ghost_width(box, 1000, 3), 1e307);
  box = {{0, 0, 0}, {1e-300, 1e-300, 1e-300}};
  EXPECT_NEAR(default_ghost_width(box, 1000, 3) / 2e-301, 1, 1e-9);
}

TEST(Baseline, FileOrderIsBlocksByIds) {
  for (const Weights weights : {Weights::none, Weights::uniform})
    for (const std::size_t count : {0U, 5U, 3000U}) {
      const Scene scene = make_scene(Shape::coincident, weights, 2, count, true, kQualitySeed);
      std::vector<Id> sorted = scene.id;
      std::sort(sorted.begin(), sorted.end());
      on_ranks([&](comm::Comm& comm) {
        const Share share = deal(scene, comm.rank(), comm.size(), kQualitySeed);
        PartitionOptions options;
        options.method = Method::file_order;
        options.parts = 7;
        const PartitionResult got = partition(comm, share.particles.view(), options).value();
        for (std::size_t i = 0; i < share.row.size(); ++i) {
          const auto place = static_cast<std::uint64_t>(
              std::lower_bound(sorted.begin(), sorted.end(), share.particles.id[i]) - sorted.begin());
          // The part p with floor(p n / 7) <= place < floor((p + 1) n / 7).
          std::int32_t part = 0;
          while ((static_cast<std::uint64_t>(part) + 1) * count / 7 <= place) ++part;
          ASSERT_EQ(got.part[i], part);
        }
      });
    }
}

TEST(Baseline, EqualBoxesHalveTheLongestSide) {
  on_ranks([](comm::Comm& comm) {
    particles::ParticleSet set;
    set.dims = 2;
    set.resize(comm.rank() == 0 ? 5 : 0);
    const std::array<Point, 5> points{{{0, 0}, {4, 4}, {2, 1}, {1.9, 2}, {1.9, 1.99}}};
    for (std::size_t i = 0; i < set.count(); ++i) {
      for (std::size_t a = 0; a < 2; ++a) set.position[a][i] = points[i][a];
      set.id[i] = static_cast<Id>(i);
    }
    PartitionOptions options;
    options.method = Method::equal_boxes;
    options.parts = 3;  // left half in two, across y since it is now the longer side
    const PartitionResult got = partition(comm, set.view(), options).value();
    EXPECT_EQ(got.tree.cuts[0].axes[0], 0);
    EXPECT_EQ(got.tree.cuts[0].key.at[0], 2);
    EXPECT_EQ(got.tree.cuts[1].axes[0], 1);
    const std::vector<std::int32_t> expected{0, 2, 2, 1, 0};
    for (std::size_t i = 0; i < set.count(); ++i) EXPECT_EQ(got.part[i], expected[i]);
  });
}

}  // namespace
}  // namespace rcb::partition
