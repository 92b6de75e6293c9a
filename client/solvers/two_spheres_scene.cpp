// The scene of two colliding elastic spheres. They need no contact law (Hertz; Landau and Lifshitz, Theory of
// Elasticity, section 9), since both balls share one grid.
#include <cmath>
#include <memory>
#include <numbers>

#include <fmt/format.h>

#include "client/solvers/scenes.hpp"

namespace rcb::solvers {
namespace {

constexpr std::uint64_t kSeeds[2] = {0x5EED0001, 0x5EED0002};
const Vec3 kFlight{0.9, 0.36, 0.24};    // direction of flight, normalised below
const Vec3 kSideways{-0.36, 0.9, 0.0};  // orthogonal to kFlight

Status check(const TwoSpheresOptions& o) {
  const auto refuse = [](std::string what, std::string hint) {
    return Status(Code::invalid_argument, std::move(what), std::move(hint));
  };
  if (o.points < 2 || o.points > kPointsMax)
    return refuse(fmt::format("{} points for two spheres", o.points), fmt::format("give 2 to {}", kPointsMax));
  if (!(o.radius > 0 && o.radius <= 1e6)) return refuse(fmt::format("a radius of {} m", o.radius), "give 0 to 1e6");
  if (!(o.gap >= 0 && o.gap <= 20 * o.radius)) return refuse(fmt::format("a gap of {} m", o.gap), "give 0 to 20 radii");
  if (!(std::abs(o.offset) <= 10 * o.radius))
    return refuse(fmt::format("an offset of {} m", o.offset), "give at most 10 radii");
  if (!(o.speed >= 0 && std::isfinite(o.speed)))
    return refuse(fmt::format("a speed of {} m/s", o.speed), "give 0 or more");
  if (!(o.interval > 0 && std::isfinite(o.interval)))
    return refuse(fmt::format("steps of {} s", o.interval), "give a number above 0");
  return {};
}

}  // namespace

Result<Simulation> make_two_spheres(const TwoSpheresOptions& o) {
  if (Status status = check(o); !status.ok()) return status;
  auto rubber = NeoHookean::create(o.density, o.youngs_modulus, o.poissons_ratio);
  if (!rubber) return rubber.status();

  const Vec3 flight = (1 / norm(kFlight)) * kFlight;
  const Vec3 sideways = (1 / norm(kSideways)) * kSideways;
  const double volume = 4.0 / 3.0 * std::numbers::pi * o.radius * o.radius * o.radius;
  const Vec3 centre = (o.radius + 0.5 * o.gap) * flight + (0.5 * o.offset) * sideways;  // of the second ball

  MpmOptions options;
  options.spacing = 2 * std::cbrt(2 * volume / static_cast<double>(o.points));  // eight points a cell
  for (std::size_t a = 0; a < 3; ++a) {
    // Leaves two radii of free space beyond the start on every side; a longer flight is reflected by the walls.
    options.hi[a] = std::abs(centre[a]) + 3 * o.radius;
    options.lo[a] = -options.hi[a];
  }
  auto mpm = Mpm::create(options);
  if (!mpm) return mpm.status();

  const auto material = std::make_shared<NeoHookean>(*rubber);
  for (int ball = 0; ball < 2; ++ball) {
    const double side = ball == 0 ? -1 : 1;
    const Vec3 middle = side * centre;
    Shape shape;
    for (std::size_t a = 0; a < 3; ++a) {
      shape.lo[a] = middle[a] - o.radius;
      shape.hi[a] = middle[a] + o.radius;
    }
    shape.volume = volume;
    shape.inside = [&](const Vec3& x) { return dot(x - middle, x - middle) <= o.radius * o.radius; };
    const std::size_t count = ball == 0 ? o.points - o.points / 2 : o.points / 2;
    if (Status status =
            mpm->add_body(material, fill(shape, count, kSeeds[ball]), volume, (-side * o.speed) * flight, {});
        !status.ok())
      return status;
  }
  return Simulation{std::move(*mpm), o.interval};
}

}  // namespace rcb::solvers
