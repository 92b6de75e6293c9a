#include "tests/bench/scenes.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "common/base/random.hpp"

namespace rcb::bench {
namespace {

using geometry::Point;

constexpr std::uint64_t kSeed = 0x5CE4E5;
constexpr std::uint64_t kMillion = 1'000'000;

// One generator a scene: the point of row i of n.
using PointOf = Point (*)(std::uint64_t i, std::uint64_t n, Random& random);

std::uint64_t lattice_side(std::uint64_t n) {
  auto side = static_cast<std::uint64_t>(std::cbrt(static_cast<double>(n)));
  while (side * side * side < n) ++side;
  return side;
}

Point uniform(std::uint64_t, std::uint64_t, Random& random) {
  return {random.uniform(), random.uniform(), random.uniform()};
}

// A slab of sediment on a slope, 20 : 2 : 5 points long, thick and wide, as a material point code fills it: a lattice,
// each point shaken by a tenth of the spacing, in the lattice's order.
Point slope(std::uint64_t i, std::uint64_t n, Random& random) {
  const double unit = std::cbrt(static_cast<double>(n) / 200.0);
  const auto thick = std::max<std::uint64_t>(1, static_cast<std::uint64_t>(2 * unit));
  const auto wide = std::max<std::uint64_t>(1, static_cast<std::uint64_t>(5 * unit));
  const auto at = [&](std::uint64_t index) { return static_cast<double>(index) + random.uniform(-0.1, 0.1); };
  const double x = at(i / (thick * wide));
  const double y = at(i % thick);
  return {x, y - 0.25 * x, at(i / thick % wide)};
}

double normal(Random& random) {
  const double radius = std::sqrt(-2 * std::log(1 - random.uniform()));
  return radius * std::cos(2 * std::numbers::pi * random.uniform());
}

// 64 clusters whose widths span two decades.
Point clusters(std::uint64_t, std::uint64_t, Random& random) {
  Random of_cluster(mix64(kSeed + 77 + random.below(64)));
  const double width = 0.1 * std::pow(10.0, of_cluster.uniform(-2, 0));
  Point point{};
  for (double& x : point) x = of_cluster.uniform() + width * normal(random);
  return point;
}

Point lattice(std::uint64_t i, std::uint64_t n, Random&) {
  const std::uint64_t side = lattice_side(n);
  return {static_cast<double>(i / (side * side)), static_cast<double>(i / side % side), static_cast<double>(i % side)};
}

Point half_coincident(std::uint64_t i, std::uint64_t n, Random& random) {
  if (i % 2 == 0) return {0.5, 0.5, 0.5};
  return uniform(i, n, random);
}

Point offset(std::uint64_t, std::uint64_t, Random& random) {
  Point point{};
  for (double& x : point) x = 1e12 + random.uniform(0, 1e-3);
  return point;
}

// Two balls about to collide.
Point two_spheres(std::uint64_t i, std::uint64_t, Random& random) {
  const double height = random.uniform(-1, 1);
  const double angle = random.uniform(0, 2 * std::numbers::pi);
  const double radius = 0.1 * std::cbrt(random.uniform());
  const double level = radius * std::sqrt(1 - height * height);
  const double side = i % 2 == 0 ? -1 : 1;
  return {side * 0.135 + level * std::cos(angle), side * 0.075 + level * std::sin(angle),
          side * 0.036 + radius * height};
}

// Both signs, 1e-6 to 1e6.
Point decades(std::uint64_t, std::uint64_t, Random& random) {
  Point point{};
  for (double& x : point) {
    const double size = std::pow(10.0, random.uniform(-6, 6));
    x = random.below(2) == 0 ? size : -size;
  }
  return point;
}

struct Scene {
  SceneKind kind;
  PointOf point;
};

constexpr Scene kScenes[] = {
    {{"slope", "a slab on a slope, jittered lattice", 3, 1'068'285}, slope},
    {{"uniform", "uniform in a cube", 3, kMillion}, uniform},
    {{"clusters", "64 clusters of very different widths", 3, kMillion}, clusters},
    {{"lattice", "an exact cubic lattice: ties everywhere", 3, kMillion}, lattice},
    {{"half-coincident", "every second point at one place", 3, kMillion}, half_coincident},
    {{"offset", "1e12 away from the origin, spread 1e-3", 3, kMillion}, offset},
    {{"plane", "uniform in a square, two dimensions", 2, kMillion}, uniform},
    {{"two-spheres", "two balls", 3, kMillion}, two_spheres},
    {{"decades", "12 decades of scale", 3, kMillion}, decades},
};

constexpr auto kKinds = [] {
  std::array<SceneKind, std::size(kScenes)> kinds{};
  for (std::size_t s = 0; s < kinds.size(); ++s) kinds[s] = kScenes[s].kind;
  return kinds;
}();

}  // namespace

std::span<const SceneKind> scene_kinds() { return kKinds; }

const SceneKind* find_scene_kind(const std::string& name) {
  const auto found = std::find_if(kKinds.begin(), kKinds.end(), [&](const SceneKind& k) { return name == k.name; });
  return found == kKinds.end() ? nullptr : &*found;
}

particles::ParticleSet make_rows(const SceneKind& kind, std::uint64_t n, std::uint64_t first, std::uint64_t last) {
  const auto number = static_cast<std::size_t>(&kind - kKinds.data());
  particles::ParticleSet set;
  set.dims = kind.dims;
  set.resize(last - first);
  for (std::uint64_t i = first; i < last; ++i) {
    Random random(mix64(kSeed + number) ^ mix64(i));
    const Point point = kScenes[number].point(i, n, random);
    for (std::size_t a = 0; a < static_cast<std::size_t>(kind.dims); ++a) set.position[a][i - first] = point[a];
    set.id[i - first] = static_cast<particles::Id>(i);
  }
  return set;
}

}  // namespace rcb::bench
