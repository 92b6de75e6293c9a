// The submarine slope: a wide sheet of sediment, thin at the head, tapering to a toe.
#include <algorithm>
#include <array>
#include <cmath>
#include <memory>

#include <fmt/format.h>

#include "client/solvers/scenes.hpp"

namespace rcb::solvers {
namespace {

// Metres. The bed falls by kFall over kLength and is level from there.
constexpr double kLength = 400;
constexpr double kFall = 100;
constexpr double kWidth = 320;
constexpr double kThickness = 40;  // at its thickest, upright
constexpr double kHead = 40;       // over which the thickness grows from 0
constexpr double kToe = 200;       // over which it goes back to 0
constexpr double kUpstream = 20;   // of domain beyond the body
constexpr double kDownstream = 150;
constexpr double kAbove = 40;
constexpr double kLowerShare = 0.4;  // of the thickness is the stiff lower layer

constexpr double kGravity = 9.81;   // m/s^2
constexpr double kSeaWater = 1025;  // kg/m^3

struct Layer {
  double from;  // as shares of the thickness
  double to;
  double density;         // saturated, kg/m^3
  double youngs_modulus;  // Pa
  double poissons_ratio;
  std::uint64_t seed;
};
// Rows of typical values for consolidated and for soft marine clay; the elastic numbers are for fast loading.
constexpr std::array kLayers{Layer{0, kLowerShare, 1900, 4e7, 0.35, 0x51093E01},
                             Layer{kLowerShare, 1, 1700, 1.5e7, 0.4, 0x51093E02}};

double bed(double x) { return kFall * (1 - x / kLength); }
double thickness(double x) { return kThickness * std::min({1.0, x / kHead, (kLength - x) / kToe}); }
constexpr double kSection = kThickness * (kLength - 0.5 * (kHead + kToe));  // m^2, of the body

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

}  // namespace

Result<Simulation> make_slope(const SlopeOptions& o) {
  if (o.points < 1 || o.points > kPointsMax)
    return Status(Code::invalid_argument, fmt::format("{} points for a slope", o.points),
                  fmt::format("give 1 to {}", kPointsMax));
  if (!(o.interval > 0 && std::isfinite(o.interval)))
    return Status(Code::invalid_argument, fmt::format("steps of {} s", o.interval), "give a number above 0");

  MpmOptions options;
  options.lo = {-kUpstream, 0, 0};
  options.hi = {kLength + kDownstream, kFall + kThickness + kAbove, kWidth};
  options.spacing = 2 * std::cbrt(kSection * kWidth / static_cast<double>(o.points));  // eight points a cell
  const double steepness = std::hypot(kFall, kLength);
  options.ground = {{{0, kFall, 0}, {kFall / steepness, kLength / steepness, 0}, true}, {{}, {0, 1, 0}, true}};
  auto mpm = Mpm::create(options);
  if (!mpm) return mpm.status();

  std::size_t left = o.points;
  for (const Layer& layer : kLayers) {
    const bool last = &layer == &kLayers.back();
    const double share = layer.to - layer.from;
    const std::size_t count = last ? left : static_cast<std::size_t>(std::floor(share * static_cast<double>(o.points)));
    left -= count;
    auto clay = NeoHookean::create(layer.density, layer.youngs_modulus, layer.poissons_ratio);
    if (!clay) return clay.status();
    const Shape shape = layer_shape(layer);
    const Vec3 gravity{0, -kGravity * (1 - kSeaWater / layer.density), 0};
    if (Status status = mpm->add_body(std::make_shared<NeoHookean>(*clay), fill(shape, count, layer.seed), shape.volume,
                                      {}, gravity);
        !status.ok())
      return status;
  }
  return Simulation{std::move(*mpm), o.interval};
}

}  // namespace rcb::solvers
