#include "tests/bench/stress/stress_scenes.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "common/base/random.hpp"
#include "tests/bench/scenes.hpp"

namespace rcb::bench {
namespace {

using Limits = std::numeric_limits<double>;
using Coordinate = double (*)(std::uint64_t i, std::size_t axis, Random& random);

constexpr std::uint64_t kSeed = 0x57E55;

double sign(Random& random) { return random.below(2) == 0 ? 1.0 : -1.0; }
double whole(Random& random, std::uint64_t below) { return static_cast<double>(random.below(below)); }

double coincident(std::uint64_t, std::size_t axis, Random&) { return 0.25 + static_cast<double>(axis); }
// Three planes: every cut but two divides one.
double planes(std::uint64_t, std::size_t axis, Random& random) {
  return axis == 0 ? whole(random, 3) : random.uniform();
}
double line(std::uint64_t, std::size_t axis, Random& random) { return axis == 1 ? random.uniform(-3, 8) : -2.5; }
double coarse(std::uint64_t, std::size_t, Random& random) { return whole(random, 4) - 1; }
double signed_zeros(std::uint64_t, std::size_t, Random& random) {
  return random.below(8) == 0 ? random.uniform(-1, 1) : sign(random) * 0.0;
}
// Eight doubles with nothing between them.
double neighbours(std::uint64_t, std::size_t, Random& random) { return 1 + whole(random, 8) * Limits::epsilon(); }
double denormal(std::uint64_t, std::size_t, Random& random) {
  return sign(random) * whole(random, 1000) * Limits::denorm_min();
}
// Longer than the greatest double from end to end.
double huge(std::uint64_t, std::size_t, Random& random) { return sign(random) * random.uniform(1e308, Limits::max()); }
// Every halving of the box leaves all but a few points on one side.
double geometric(std::uint64_t, std::size_t, Random& random) {
  return std::ldexp(1 + random.uniform(), -static_cast<int>(random.below(1000)));
}
// All in a corner of a box that one point in a thousand makes enormous.
double outliers(std::uint64_t i, std::size_t, Random& random) {
  return i % 1000 == 7 ? sign(random) * random.uniform(0, 1e300) : random.uniform();
}
// Any finite double is as likely as any other.
double all_doubles(std::uint64_t, std::size_t, Random& random) {
  return sign(random) * std::ldexp(1 + random.uniform(), static_cast<int>(random.below(2046)) - 1022);
}

struct Scene {
  StressScene scene;
  Coordinate coordinate;  // null: rcb_bench's scene of that name
};

constexpr Scene kScenes[] = {
    {{"uniform", "uniform in a cube", 3}, nullptr},
    {{"clusters", "64 clusters of very different widths", 3}, nullptr},
    {{"lattice", "an exact cubic lattice", 3}, nullptr},
    {{"coarse", "64 places: a coarse lattice, many points at each", 3}, coarse},
    {{"half-coincident", "every second point at one place", 3}, nullptr},
    {{"coincident", "all points at one place", 3}, coincident},
    {{"planes", "three planes", 3}, planes},
    {{"line", "a line along y in space", 3}, line},
    {{"offset", "1e12 away from the origin, spread 1e-3", 3}, nullptr},
    {{"neighbours", "eight neighbouring doubles around 1", 3}, neighbours},
    {{"signed-zeros", "0.0 and -0.0, with a few others", 2}, signed_zeros},
    {{"decades", "12 decades, both signs", 3}, nullptr},
    {{"geometric", "from 2^-1000 to 1, evenly in the exponent", 2}, geometric},
    {{"all-doubles", "2^-1022 to 2^1024, both signs", 1}, all_doubles},
    {{"outliers", "a unit cube, one point in a thousand up to 1e300 away", 3}, outliers},
    {{"denormal", "up to 1000 times the least double, both signs", 3}, denormal},
    {{"huge", "1e308 to 1.8e308, both signs", 3}, huge},
};

constexpr auto kNames = [] {
  std::array<StressScene, std::size(kScenes)> names{};
  for (std::size_t s = 0; s < names.size(); ++s) names[s] = kScenes[s].scene;
  return names;
}();

}  // namespace

std::span<const StressScene> stress_scenes() { return kNames; }

const StressScene* find_stress_scene(const std::string& name) {
  const auto found = std::find_if(kNames.begin(), kNames.end(), [&](const StressScene& s) { return name == s.name; });
  return found == kNames.end() ? nullptr : &*found;
}

particles::ParticleSet make_stress_rows(const StressScene& scene, std::uint64_t n, std::uint64_t first,
                                        std::uint64_t last) {
  const auto number = static_cast<std::size_t>(&scene - kNames.data());
  const Coordinate coordinate = kScenes[number].coordinate;
  if (coordinate == nullptr) return make_rows(*find_scene_kind(scene.name), n, first, last);
  particles::ParticleSet set;
  set.dims = scene.dims;
  set.resize(last - first);
  for (std::uint64_t i = first; i < last; ++i) {
    Random random(mix64(kSeed + number) ^ mix64(i));
    for (std::size_t a = 0; a < static_cast<std::size_t>(scene.dims); ++a)
      set.position[a][i - first] = coordinate(i, a, random);
    set.id[i - first] = static_cast<particles::Id>(i);
  }
  return set;
}

}  // namespace rcb::bench
