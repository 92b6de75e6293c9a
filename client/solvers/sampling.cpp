#include "client/solvers/sampling.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "common/base/check.hpp"
#include "common/base/random.hpp"

namespace rcb::solvers {
namespace {

constexpr double kShake = 0.1;  // of the spacing, to either side
constexpr int kTriesMax = 200;

Cloud shaken_lattice(const Shape& shape, double spacing, std::uint64_t seed) {
  std::array<std::uint64_t, 3> cells{};
  for (std::size_t a = 0; a < 3; ++a)
    cells[a] = static_cast<std::uint64_t>(std::ceil((shape.hi[a] - shape.lo[a]) / spacing));
  Cloud cloud;
  for (std::uint64_t i = 0; i < cells[0]; ++i)
    for (std::uint64_t j = 0; j < cells[1]; ++j)
      for (std::uint64_t k = 0; k < cells[2]; ++k) {
        Random random(mix64(seed + (i * cells[1] + j) * cells[2] + k));
        const std::array<double, 3> at{static_cast<double>(i), static_cast<double>(j), static_cast<double>(k)};
        Vec3 x;
        for (std::size_t a = 0; a < 3; ++a)
          x[a] = shape.lo[a] + (at[a] + 0.5 + random.uniform(-kShake, kShake)) * spacing;
        if (!shape.inside(x)) continue;
        for (std::size_t a = 0; a < 3; ++a) cloud.position[a].push_back(x[a]);
      }
  return cloud;
}

// Leaves out all but `count`, those of the smallest hash; the rest keep their order.
void thin_out(Cloud& cloud, std::size_t count, std::uint64_t seed) {
  const std::size_t surplus = cloud.size() - count;
  if (surplus == 0) return;
  std::vector<std::pair<std::uint64_t, std::size_t>> order(cloud.size());
  for (std::size_t p = 0; p < order.size(); ++p) order[p] = {mix64(mix64(seed) ^ p), p};
  std::nth_element(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(surplus), order.end());
  std::vector<char> out(cloud.size(), 0);
  for (std::size_t k = 0; k < surplus; ++k) out[order[k].second] = 1;
  for (auto& axis : cloud.position) {
    std::size_t kept = 0;
    for (std::size_t p = 0; p < out.size(); ++p)
      if (out[p] == 0) axis[kept++] = axis[p];
    axis.resize(kept);
  }
}

}  // namespace

Cloud fill(const Shape& shape, std::size_t count, std::uint64_t seed) {
  if (count == 0) return {};
  double spacing = std::cbrt(shape.volume / static_cast<double>(count)) * 0.999;
  for (int tries = 0; tries < kTriesMax; ++tries) {
    Cloud cloud = shaken_lattice(shape, spacing, seed);
    if (cloud.size() >= count) {
      thin_out(cloud, count, seed);
      return cloud;
    }
    // A little finer than the count found suggests; never below half, where a coarse lattice says little.
    const double share = static_cast<double>(cloud.size()) / static_cast<double>(count);
    spacing *= 0.998 * std::cbrt(std::max(share, 0.125));
  }
  CHECK(false, "a shape that no lattice fills");
  return {};
}

}  // namespace rcb::solvers
