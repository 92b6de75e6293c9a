#include "client/solvers/mpm/sampling.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "common/base/check.hpp"
#include "common/base/random.hpp"

namespace rcb::solvers {
namespace {

constexpr double kJitter = 0.1;  // largest displacement, as a share of the spacing
constexpr int kTriesMax = 200;

// The lattice's three directions, oblique to the axes: whole planes of an aligned lattice would cross a cut at once.
// They are the rows of a rotation by 0.35, 0.55 and 0.8 rad about z, y and x.
std::array<Vec3, 3> directions() {
  const double cz = std::cos(0.35), sz = std::sin(0.35);
  const double cy = std::cos(0.55), sy = std::sin(0.55);
  const double cx = std::cos(0.80), sx = std::sin(0.80);
  return {Vec3{cz * cy, sz * cy, -sy}, Vec3{cz * sy * sx - sz * cx, sz * sy * sx + cz * cx, cy * sx},
          Vec3{cz * sy * cx + sz * sx, sz * sy * cx - cz * sx, cy * cx}};
}

// The range [low, high] of t for which from + t * direction lies within half_size of 0 on every axis; empty: low >
// high.
std::array<double, 2> stretch_inside(const Vec3& from, const Vec3& direction, const Vec3& half_size) {
  double low = -1e300;
  double high = 1e300;
  for (std::size_t a = 0; a < 3; ++a) {
    const double one = (-half_size[a] - from[a]) / direction[a];
    const double other = (half_size[a] - from[a]) / direction[a];
    low = std::max(low, std::min(one, other));
    high = std::min(high, std::max(one, other));
  }
  return {low, high};
}

Cloud shaken_lattice(const Shape& shape, double spacing, std::uint64_t seed) {
  const std::array<Vec3, 3> along = directions();
  const Vec3 middle = 0.5 * (shape.lo + shape.hi);
  const double slack = (0.5 + kJitter) * spacing * std::sqrt(3.0);
  const Vec3 half_size = 0.5 * (shape.hi - shape.lo) + Vec3{slack, slack, slack};
  std::array<std::int64_t, 2> reach{};
  for (std::size_t d = 0; d < 2; ++d)
    for (std::size_t a = 0; a < 3; ++a)
      reach[d] += static_cast<std::int64_t>(std::ceil(std::abs(along[d][a]) * half_size[a] / spacing));
  Random phases(mix64(seed));
  const Vec3 phase{phases.uniform(), phases.uniform(), phases.uniform()};
  Cloud cloud;
  std::uint64_t candidate = 0;
  for (std::int64_t i = -reach[0]; i <= reach[0]; ++i)
    for (std::int64_t j = -reach[1]; j <= reach[1]; ++j) {
      const Vec3 line = (spacing * (static_cast<double>(i) + phase[0])) * along[0] +
                        (spacing * (static_cast<double>(j) + phase[1])) * along[1];
      const auto [low, high] = stretch_inside(line, along[2], half_size);
      for (double k = std::ceil(low / spacing); k <= high / spacing; ++k) {
        Random random(mix64(seed + ++candidate));
        Vec3 x = middle + line + (spacing * (k + phase[2])) * along[2];
        for (std::size_t a = 0; a < 3; ++a) x[a] += random.uniform(-kJitter, kJitter) * spacing;
        if (!shape.inside(x)) continue;
        for (std::size_t a = 0; a < 3; ++a) cloud.position[a].push_back(x[a]);
      }
    }
  return cloud;
}

// Removes the points with the smallest hashes until `count` are left; these keep their order.
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
    // Next spacing: a little finer than the number of points suggests, but at least about half, since too few points
    // suggest nothing reliable.
    const double share = static_cast<double>(cloud.size()) / static_cast<double>(count);
    spacing *= 0.998 * std::cbrt(std::max(share, 0.125));
  }
  RCB_CHECK(false, "a shape that no lattice fills");
  return {};
}

}  // namespace rcb::solvers
