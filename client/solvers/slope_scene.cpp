// The submarine slope: a wide sheet of sediment on a weak bed, thin at its head and tapering to a toe. And a column of
// the same material, but dry, whose collapse has been measured in experiments.
#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <numbers>

#include <fmt/format.h>

#include "client/solvers/mpm/granular.hpp"
#include "client/solvers/scenes.hpp"

namespace rcb::solvers {
namespace {

// Metres. The bed falls by kFall over the length kLength and is level beyond.
constexpr double kLength = 400;
constexpr double kFall = 100;
constexpr double kWidth = 320;
constexpr double kThickness = 40;  // largest, vertical
constexpr double kHead = 40;       // length over which the thickness grows from 0
constexpr double kToe = 200;       // length over which it falls back to 0
constexpr double kUpstream = 20;   // of empty domain beyond the body
constexpr double kDownstream = 600;
constexpr double kAbove = 40;
constexpr double kLowerShare = 0.4;  // share of the thickness that the stiff lower layer takes

constexpr double kGravity = 9.81;   // m/s^2
constexpr double kSeaWater = 1025;  // kg/m^3

struct Layer {
  double from;  // shares of the thickness
  double to;
  double stiffness;  // relative to the upper layer
  std::uint64_t seed;
};
constexpr std::array kLayers{Layer{0, kLowerShare, 1.5, 0x51093E01}, Layer{kLowerShare, 1, 1, 0x51093E02}};

double bed(double x) { return kFall * (1 - x / kLength); }
double thickness(double x) { return kThickness * std::min({1.0, x / kHead, (kLength - x) / kToe}); }
constexpr double kSection = kThickness * (kLength - 0.5 * (kHead + kToe));  // m^2, longitudinal section of the body

Shape layer_shape(const Layer& layer) {
  Shape shape;
  shape.lo = {0, 0, 0};
  shape.hi = {kLength, kFall + kThickness, kWidth};
  shape.volume = kSection * kWidth * (layer.to - layer.from);
  shape.inside = [&layer](const Vec3& x) {
    const double above = x[1] - bed(x[0]);
    const double thick = thickness(x[0]);
    return above > layer.from * thick && above <= layer.to * thick && x[2] >= 0 && x[2] <= kWidth;
  };
  return shape;
}

double tangent(double degrees) { return std::tan(degrees * std::numbers::pi / 180); }

Status check(std::uint64_t points, double interval) {
  if (points < 1 || points > kPointsMax)
    return {Code::invalid_argument, fmt::format("{} points of sediment", points),
            fmt::format("give 1 to {}", kPointsMax)};
  if (!(interval > 0 && std::isfinite(interval)))
    return {Code::invalid_argument, fmt::format("steps of {} s", interval), "give a number above 0"};
  return {};
}

}  // namespace

Result<Simulation> make_slope(const SlopeOptions& o) {
  if (Status status = check(o.points, o.interval); !status.ok()) return status;
  if (!(o.unit_weight > 0 && std::isfinite(o.unit_weight)))
    return Status(Code::invalid_argument, fmt::format("a submerged unit weight of {} N/m^3", o.unit_weight),
                  "give a number above 0");
  if (!(o.bed_friction >= 0 && o.bed_friction < 90))
    return Status(Code::invalid_argument, fmt::format("a bed friction of {} degrees", o.bed_friction),
                  "give 0 or more, below 90");

  MpmOptions options;
  options.lo = {-kUpstream, 0, 0};
  options.hi = {kLength + kDownstream, kFall + kThickness + kAbove, kWidth};
  options.spacing = 2 * std::cbrt(kSection * kWidth / static_cast<double>(o.points));  // eight points a cell
  const double steepness = std::hypot(kFall, kLength);
  const double friction = tangent(o.bed_friction);
  options.ground = {{{0, kFall, 0}, {kFall / steepness, kLength / steepness, 0}, friction}, {{}, {0, 1, 0}, friction}};
  auto mpm = Mpm::create(options);
  if (!mpm) return mpm.status();

  // Water and grains move together: all their mass has inertia, but only the submerged weight pulls.
  const double density = kSeaWater + o.unit_weight / kGravity;
  const Vec3 gravity{0, -o.unit_weight / density, 0};
  std::size_t left = o.points;
  for (const Layer& layer : kLayers) {
    const bool last = &layer == &kLayers.back();
    const double share = layer.to - layer.from;
    const std::size_t count = last ? left : static_cast<std::size_t>(std::floor(share * static_cast<double>(o.points)));
    left -= count;
    auto sediment = Granular::create(density, layer.stiffness * o.youngs_modulus, o.poissons_ratio, o.friction_angle);
    if (!sediment) return sediment.status();
    const Shape shape = layer_shape(layer);
    if (Status status = mpm->add_body(std::make_shared<Granular>(*sediment), fill(shape, count, layer.seed),
                                      shape.volume, {}, gravity);
        !status.ok())
      return status;
  }
  return Simulation{std::move(*mpm), o.interval, kLength};
}

Result<Simulation> make_column(const ColumnOptions& o) {
  if (Status status = check(o.points, o.interval); !status.ok()) return status;
  if (!(o.aspect >= 0.1 && o.aspect <= 20))
    return Status(Code::invalid_argument, fmt::format("a column {} times as high as long", o.aspect), "give 0.1 to 20");
  constexpr double kBase = 40;  // m, from the wall at x = 0 to the gate
  constexpr double kDensity = 1600;
  constexpr double kStrain = 0.005;  // strain at the foot under the column's weight; sets the stiffness
  constexpr double kPoisson = 0.3;
  const double height = o.aspect * kBase;
  MpmOptions options;
  options.spacing = std::sqrt(16 * kBase * height / static_cast<double>(o.points));  // eight points a cell, two across
  const double width = 2 * options.spacing;
  // Room for twice the measured run-out: 1.2 a base lengths for low columns, 1.9 a^(2/3) for high ones (a: the aspect).
  options.hi = {kBase * (2 + 3 * o.aspect), height + 2 * options.spacing, width};
  options.ground = {{{}, {0, 1, 0}, tangent(o.friction_angle)}};
  auto mpm = Mpm::create(options);
  if (!mpm) return mpm.status();

  const double stiffness = kDensity * kGravity * height / kStrain;  // in uniaxial strain
  const double youngs_modulus = stiffness * (1 + kPoisson) * (1 - 2 * kPoisson) / (1 - kPoisson);
  auto sand = Granular::create(kDensity, youngs_modulus, kPoisson, o.friction_angle);
  if (!sand) return sand.status();
  Shape shape;
  shape.hi = {kBase, height, width};
  shape.volume = kBase * height * width;
  shape.inside = [hi = shape.hi](const Vec3& x) {
    return x[0] >= 0 && x[0] <= hi[0] && x[1] >= 0 && x[1] <= hi[1] && x[2] >= 0 && x[2] <= hi[2];
  };
  if (Status status = mpm->add_body(std::make_shared<Granular>(*sand), fill(shape, o.points, 0xC0104801), shape.volume,
                                    {}, {0, -kGravity, 0});
      !status.ok())
    return status;
  return Simulation{std::move(*mpm), o.interval, kBase};
}

double front(const Mpm& mpm) {
  const auto x = mpm.position(0);
  std::vector<double> sorted(x.begin(), x.end());
  if (sorted.empty()) return 0;
  const auto place = static_cast<std::ptrdiff_t>(kFrontShare * static_cast<double>(sorted.size() - 1));
  std::nth_element(sorted.begin(), sorted.begin() + place, sorted.end());
  return sorted[static_cast<std::size_t>(place)];
}

std::vector<NumberOption> slope_numbers(SlopeOptions& options) {
  return {{"--unit-weight", "of the sediment, submerged, N/m^3", &options.unit_weight},
          {"--friction-angle", "of the sediment, degrees", &options.friction_angle},
          {"--bed-friction", "between sediment and bed, degrees", &options.bed_friction},
          {"--youngs-modulus", "stiffness of the upper layer, Pa; the lower one has half as much again",
           &options.youngs_modulus},
          {"--poissons-ratio", "-1 to 0.5", &options.poissons_ratio},
          {"--interval", "time of a step, s; substeps are taken as stability asks", &options.interval}};
}

}  // namespace rcb::solvers
