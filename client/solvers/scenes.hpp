// The example scenes, ready to run. SI units throughout.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "client/solvers/mpm/mpm.hpp"
#include "common/base/status.hpp"

namespace rcb::solvers {

constexpr std::uint64_t kPointsMax = 100'000'000;

// A physical parameter that the user may set.
struct NumberOption {
  std::string name;  // "--speed"
  std::string help;
  double* value;  // initially the default
};

struct Simulation {
  Mpm mpm;
  double interval;    // s, between pushed steps
  double length = 0;  // m, initial length of a body that runs out along x; 0: none does
};

// The x up to which the body reaches, not counting a few stray points ahead of it.
constexpr double kFrontShare = 0.995;  // share of the points that lie behind the front
double front(const Mpm& mpm);

// Two elastic rubber balls of the same size fly at each other in a closed box, meet a little off-centre and rebound.
// Their line of flight is oblique to the axes, so that particles move across every cut of a partition.
struct TwoSpheresOptions {
  std::uint64_t points = 1500;  // 2 .. kPointsMax, half in each ball; the first ball has the odd one
  double radius = 0.1;          // m
  double gap = 0.1;             // m, between the surfaces at the start
  double offset = 0.03;         // m, between the lines of flight; 0 is head on
  double speed = 4;             // m/s, of each ball, towards the other
  double youngs_modulus = 1e6;  // Pa
  double poissons_ratio = 0.3;
  double density = 1000;   // kg/m^3
  double interval = 3e-4;  // s, a step
};
Result<Simulation> make_two_spheres(const TwoSpheresOptions& options);

// A submarine slope: two layers of cohesionless sediment on an inclined, weak bed that ends in a flat basin. x points
// down the slope, y up, z across. Water carries part of the weight. Its drag and its pore pressure are left out (a low
// bed friction stands for the latter). The slope is unstable: it slides, spreads and comes to rest.
struct SlopeOptions {
  std::uint64_t points = 20'000;  // 1 .. kPointsMax
  double unit_weight = 7500;      // N/m^3, submerged
  double friction_angle = 30;     // degrees, of the sediment
  double bed_friction = 10;       // degrees, between sediment and bed
  double youngs_modulus = 1e7;    // Pa, of the upper layer
  double poissons_ratio = 0.3;
  double interval = 0.3;  // s, a step
};
Result<Simulation> make_slope(const SlopeOptions& options);
// Its physical parameters; they refer to `options`.
std::vector<NumberOption> slope_numbers(SlopeOptions& options);

// A column of dry sand between smooth walls two grid cells apart, behind a gate that vanishes at the start: x points
// out of the gate, y up. Experiments: Lube et al. 2005, doi:10.1103/PhysRevE.72.041301.
struct ColumnOptions {
  std::uint64_t points = 20'000;  // 1 .. kPointsMax
  double aspect = 1;              // height over length, 0.1 .. 20
  double friction_angle = 30;     // degrees, of the sand and of the bed
  double interval = 0.3;          // s, a step
};
Result<Simulation> make_column(const ColumnOptions& options);

}  // namespace rcb::solvers
