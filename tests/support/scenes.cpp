#include "tests/support/scenes.hpp"

#include <cmath>
#include <limits>
#include <numeric>

namespace rcb::testing {
namespace {

double coordinate(Shape shape, std::size_t axis, Random& random) {
  const auto sign = [&random] { return random.below(2) == 0 ? 1.0 : -1.0; };
  switch (shape) {
    case Shape::uniform:
      return random.uniform(-1, 1);
    case Shape::lattice:
      return static_cast<double>(random.below(4)) - 1;
    case Shape::coincident:
      return 0.25 + static_cast<double>(axis);
    case Shape::half_coincident:
      return random.uniform(0, 1);
    case Shape::planes:
      return axis == 0 ? static_cast<double>(random.below(3)) * 5 : random.uniform(0, 1);
    case Shape::decades:
      return sign() * std::pow(10.0, random.uniform(-6, 6));
    case Shape::offset:
      return 1e12 + random.uniform(0, 1e-3);
    case Shape::denormal:
      return sign() * static_cast<double>(random.below(9)) * std::numeric_limits<double>::denorm_min();
    case Shape::huge:
      return sign() * random.uniform(1e308, std::numeric_limits<double>::max());
    case Shape::signed_zero:
      return random.below(8) == 0 ? random.uniform(-1, 1) : sign() * 0.0;
    case Shape::clusters:
      return std::floor(random.uniform(0, 3)) + 1e-9 * random.uniform();
    case Shape::line:
      return axis == 1 ? random.uniform(-3, 8) : -2.5;
  }
  return 0;
}

double weight_of(Weights weights, std::size_t row, std::size_t count, Random& random) {
  switch (weights) {
    case Weights::uniform:
      return random.uniform(0.5, 2);
    case Weights::zeros:
      return random.below(3) == 0 ? random.uniform() : 0.0;
    case Weights::giant:
      return row == count / 2 ? 1e6 : random.uniform();
    case Weights::equal:
      return 2.5;
    case Weights::small_integers:
      return static_cast<double>(random.below(4));
    case Weights::wide:
      return std::ldexp(1 + std::floor(random.uniform(0, 4)), static_cast<int>(random.below(40)) - 20);
    default:
      return 0;
  }
}

template <typename T>
void shuffle(std::vector<T>& values, Random& random) {
  for (std::size_t i = values.size(); i > 1; --i) std::swap(values[i - 1], values[random.below(i)]);
}

}  // namespace

Scene make_scene(Shape shape, Weights weights, int dims, std::size_t count, bool scattered_ids, std::uint64_t seed) {
  Random random(mix64(seed));
  Scene scene;
  scene.name = "shape " + std::to_string(static_cast<int>(shape)) + ", weights " +
               std::to_string(static_cast<int>(weights)) + ", dims " + std::to_string(dims) + ", n " +
               std::to_string(count) + ", seed " + std::to_string(seed);
  scene.dims = dims;
  for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a)
    for (std::size_t i = 0; i < count; ++i) scene.x[a].push_back(coordinate(shape, a, random));
  if (shape == Shape::half_coincident)
    for (std::size_t i = 0; i < count; i += 2)
      for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) scene.x[a][i] = 0.5;
  const std::uint64_t stride = count == 0 ? 1 : (std::uint64_t{1} << 63U) / count;
  for (std::size_t i = 0; i < count; ++i)
    scene.id.push_back(static_cast<std::int64_t>(scattered_ids ? i * stride + random.below(stride) : i));
  if (scattered_ids && count > 0) scene.id.back() = std::numeric_limits<std::int64_t>::max();
  shuffle(scene.id, random);
  for (std::size_t i = 0; i < count && weights != Weights::none; ++i)
    scene.weight.push_back(weight_of(weights, i, count, random));
  return scene;
}

Share take(const Scene& scene, std::vector<std::size_t> rows) {
  Share share;
  share.row = std::move(rows);
  share.particles.dims = scene.dims;
  share.particles.has_weights = !scene.weight.empty();
  share.particles.resize(share.row.size());
  for (std::size_t i = 0; i < share.row.size(); ++i) {
    for (std::size_t a = 0; a < static_cast<std::size_t>(scene.dims); ++a)
      share.particles.position[a][i] = scene.x[a][share.row[i]];
    share.particles.id[i] = scene.id[share.row[i]];
    if (share.particles.has_weights) share.particles.weight[i] = scene.weight[share.row[i]];
  }
  return share;
}

Share deal(const Scene& scene, int rank, int ranks, std::uint64_t seed) {
  Random random(mix64(seed ^ 0x5EEDU));
  const std::uint64_t way = random.below(3);
  const auto all = static_cast<std::uint64_t>(ranks);
  const std::uint64_t favourite = random.below(all);
  std::vector<std::size_t> rows;
  for (std::size_t i = 0; i < scene.count(); ++i) {
    const std::uint64_t owner = way == 0 ? random.below(all) : way == 1 ? i * all / scene.count() : favourite;
    if (owner == static_cast<std::uint64_t>(rank)) rows.push_back(i);
  }
  Random local(mix64(seed + static_cast<std::uint64_t>(rank)));
  shuffle(rows, local);
  return take(scene, std::move(rows));
}

}  // namespace rcb::testing
