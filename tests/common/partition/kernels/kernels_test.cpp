// Each kernel, in all instruction sets that the processor has, against a plain loop.
#include "common/partition/kernels/kernels.hpp"

#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "common/base/random.hpp"

namespace rcb::partition {
namespace {

constexpr std::uint64_t kRounds = 3000;
constexpr double kTiny = std::numeric_limits<double>::denorm_min();

// A block of particles whose coordinates are often alike, and bounds for them.
struct KernelScene {
  Random random;
  int dims;
  std::array<std::vector<double>, geometry::kDimsMax> own;
  Axes x{};

  explicit KernelScene(std::uint64_t seed) : random(seed), dims(1 + static_cast<int>(random.below(3))) {
    const std::uint64_t kind = random.below(4);
    for (std::size_t a = 0; a < x.size(); ++a) {
      own[a].resize(kBlock + 3);
      for (double& value : own[a]) value = coordinate(kind);
      const auto unaligned = static_cast<std::ptrdiff_t>(random.below(4));
      x[a] = static_cast<int>(a) < dims ? own[a].data() + unaligned : x[0];
    }
  }

  double coordinate(std::uint64_t kind) {
    static constexpr std::array<double, 12> kHostile{0.0,    -0.0,   kTiny,  -kTiny, 1e-310, 1e308,
                                                     -1e308, 1e-160, -3e-46, 1e39,   0.5,    -0.25};
    if (kind == 0 || (kind > 1 && random.below(16) == 0)) return kHostile[random.below(kHostile.size())];
    if (kind == 1) return static_cast<double>(random.below(9)) / 8 - 0.5;
    return random.uniform(-1, 1);
  }
  // Of a particle, or just above or below it.
  double near(std::size_t axis) {
    const double value = x[axis][random.below(kBlock)];
    const std::uint64_t kind = random.below(4);
    return kind == 0   ? std::nextafter(value, Bounds::kInfinity)
           : kind == 1 ? std::nextafter(value, -Bounds::kInfinity)
                       : value;
  }
  Bounds bounds() {
    geometry::Box box;
    for (std::size_t a = 0; a < x.size(); ++a) {
      box.lo[a] = near(a);
      box.hi[a] = near(a);
      if (random.below(4) != 0 && box.lo[a] > box.hi[a]) std::swap(box.lo[a], box.hi[a]);
    }
    return Bounds::of(box, dims);
  }
};

template <typename Check>
void on_all_sets(const Check& check) {
  for (const InstructionSet set : {InstructionSet::baseline, InstructionSet::avx2, InstructionSet::avx512}) {
    if (set > instruction_set()) break;
    for (std::uint64_t seed = 0; seed < kRounds && !::testing::Test::HasFailure(); ++seed) {
      SCOPED_TRACE(fmt::format("seed {}, instruction set {}", seed, static_cast<int>(set)));
      KernelScene scene(seed);
      check(kernels(set), scene);
    }
  }
}

std::uint64_t outside_by_loop(const KernelScene& scene, const auto& box_of) {
  std::uint64_t bits = 0;
  for (std::size_t i = 0; i < kBlock; ++i)
    for (std::size_t a = 0; a < static_cast<std::size_t>(scene.dims); ++a)
      if (scene.x[a][i] < box_of(i).lo[a] || scene.x[a][i] > box_of(i).hi[a]) bits |= std::uint64_t{1} << i;
  return bits;
}

TEST(Kernels, WalkFindsTheBucketsOfTheSplitters) {
  std::array<std::uint64_t, Splitters::kBuckets> found{};
  on_all_sets([&](const Kernels& own, KernelScene& scene) {
    Splitters splitters;
    for (Splitters::Node& node : splitters.nodes) {
      if (scene.random.below(8) == 0) continue;
      node.axis = static_cast<std::int32_t>(scene.random.below(static_cast<std::uint64_t>(scene.dims)));
      const auto axis = static_cast<std::size_t>(node.axis);
      node.least = scene.near(axis);
      node.most = scene.random.below(3) == 0 ? node.least : std::max(node.least, scene.near(axis));
    }
    for (std::size_t a = 0; a < static_cast<std::size_t>(scene.dims) && scene.random.below(2) == 0; ++a) {
      const auto [least, most] = std::minmax_element(scene.x[a], scene.x[a] + kBlock);
      splitters.rounded.fit(a, *least, *most);
    }
    std::array<std::int32_t, kBlock> bucket;
    own.walk(WalkTables(splitters), scene.x, bucket.data());
    for (std::size_t i = 0; i < kBlock; ++i) {
      std::size_t node = 0;
      while (node < Splitters::kNodes) {
        const auto axis = static_cast<std::size_t>(splitters.nodes[node].axis);
        const auto end = [&](double value) {
          return std::isinf(value) ? static_cast<float>(value) : splitters.rounded(axis, value);
        };
        const float on = splitters.rounded(axis, scene.x[axis][i]);
        const bool right = on > end(splitters.nodes[node].most);
        if (on >= end(splitters.nodes[node].least) && !right) break;
        node = 2 * node + (right ? 2 : 1);
      }
      ASSERT_EQ(bucket[i], static_cast<std::int32_t>(node)) << "particle " << i;
      ++found[node];
    }
  });
  for (std::size_t bucket = 0; bucket < found.size(); ++bucket) EXPECT_GT(found[bucket], 0U) << bucket;
}

TEST(Kernels, OutsideOwnComparesEachWithTheBoxOfItsBucket) {
  on_all_sets([](const Kernels& own, KernelScene& scene) {
    std::vector<Bounds> boxes(1 + scene.random.below(200));
    for (Bounds& box : boxes) box = scene.bounds();
    std::array<std::int32_t, kBlock> bucket;
    for (std::int32_t& one : bucket) one = static_cast<std::int32_t>(scene.random.below(boxes.size()));
    const std::uint64_t expected =
        outside_by_loop(scene, [&](std::size_t i) { return boxes[static_cast<std::size_t>(bucket[i])]; });
    ASSERT_EQ(own.outside_own(scene.x, bucket.data(), boxes.data()), expected);
  });
}

TEST(Kernels, OutsideComparesAllWithOneBox) {
  on_all_sets([](const Kernels& own, KernelScene& scene) {
    const Bounds box = scene.bounds();
    ASSERT_EQ(own.outside(scene.x, box), outside_by_loop(scene, [&](std::size_t) { return box; }));
  });
}

TEST(Kernels, QuantiseMakesThePointsAndTellsWhetherTheyAreLossless) {
  std::uint64_t lossless_axes = 0;
  std::uint64_t lossy_axes = 0;
  on_all_sets([&](const Kernels& own, KernelScene& scene) {
    LinearMaps maps;
    for (std::size_t a = 0; a < static_cast<std::size_t>(scene.dims); ++a) {
      maps.base[a] = scene.random.below(2) == 0 ? -0.5 : scene.near(a) * 0.5;
      maps.scale[a] = std::ldexp(1.0, static_cast<int>(scene.random.below(60)) - 20);
      maps.step[a] = 1 / maps.scale[a];
    }
    std::array<std::uint32_t, kBlock> index;
    for (std::uint32_t& one : index) one = static_cast<std::uint32_t>(scene.random.next());
    std::array<QuantisedPoint, kBlock> points;
    std::array<QuantisedPoint, kBlock> checked;
    Lossless lossless;
    own.quantise(scene.x, index.data(), maps, points.data(), nullptr);
    own.quantise(scene.x, index.data(), maps, checked.data(), &lossless);
    for (std::size_t a = 0; a < scene.x.size(); ++a) {
      std::int32_t bits = Lossless::kNoBits;
      bool same = true;
      for (std::size_t i = 0; i < kBlock; ++i) {
        const double value = scene.x[a][i];
        const double scaled = (value / 2 - maps.base[a]) * maps.scale[a];
        const std::int32_t q = scaled <= 0                  ? 0
                               : scaled >= LinearMaps::kTop ? LinearMaps::kTop
                                                            : static_cast<std::int32_t>(scaled);
        ASSERT_EQ(points[i].q[a], q) << "particle " << i << ", axis " << a << ", " << value;
        ASSERT_EQ(checked[i].q[a], q);
        bits |= q;
        same = same && 2 * (maps.base[a] + q * maps.step[a]) == value;
      }
      if (maps.scale[a] == 0) continue;
      ASSERT_EQ(lossless.zeros(a), same ? std::countr_zero(static_cast<std::uint32_t>(bits)) : -1) << "axis " << a;
      ++(same ? lossless_axes : lossy_axes);
    }
    for (std::size_t i = 0; i < kBlock; ++i) {
      ASSERT_EQ(points[i].index, index[i]);
      ASSERT_EQ(checked[i].index, index[i]);
    }
  });
  EXPECT_GT(lossless_axes, 100U);
  EXPECT_GT(lossy_axes, 100U);
}

TEST(Kernels, WidenAddsPointsToBounds) {
  on_all_sets([](const Kernels& own, KernelScene& scene) {
    std::vector<QuantisedPoint> points(scene.random.below(70));
    QBounds expected;
    if (scene.random.below(2) == 0) expected = {{5, 1000, 1 << 30}, {50, 1000, (1 << 30) + 9}};
    QBounds bounds = expected;
    for (QuantisedPoint& point : points) {
      for (std::int32_t& q : point.q)
        q = static_cast<std::int32_t>(scene.random.below(std::uint64_t{LinearMaps::kTop} + 1) >>
                                      scene.random.below(31));
      point.index = static_cast<std::uint32_t>(scene.random.next());
      expected.extend({point.q, point.q});
    }
    own.widen(bounds, points);
    ASSERT_EQ(bounds.lo, expected.lo);
    ASSERT_EQ(bounds.hi, expected.hi);
  });
}

}  // namespace
}  // namespace rcb::partition
