// The example scenes as ready-made simulations. SI units throughout.
#pragma once

#include <cstdint>

#include "client/solvers/mpm.hpp"
#include "common/base/status.hpp"

namespace rcb::solvers {

constexpr std::uint64_t kPointsMax = 100'000'000;

struct Simulation {
  Mpm mpm;
  double interval;    // s, between two pushed steps
  double length = 0;  // m, of what runs out along x; 0: nothing does
};

// How far along x the body reaches: a few stray points in front of it don't count.
constexpr double kFrontShare = 0.995;  // of the points lie behind the front
double front(const Mpm& mpm);

// Two elastic balls of the same size, made of rubber, fly at each other in a closed box, meet a little off-centre and
// rebound. Their line of flight is oblique to the axes, so that every cut of a partition sees them move.
struct TwoSpheresOptions {
  std::uint64_t points = 1500;  // 2 .. kPointsMax, shared out evenly; the first ball has the odd one
  double radius = 0.1;          // m
  double gap = 0.1;             // m, between the surfaces at the start
  double offset = 0.03;         // m, between the lines of flight; 0 is head on
  double speed = 4;             // m/s, of each ball, at the other
  double youngs_modulus = 1e6;  // Pa
  double poissons_ratio = 0.3;
  double density = 1000;   // kg/m^3
  double interval = 3e-4;  // s, a step
};
Result<Simulation> make_two_spheres(const TwoSpheresOptions& options);

// A submarine slope: two layers of cohesionless sediment on an inclined, weak bed that runs out into a flat basin. x
// runs down the slope, y up, z across. Water carries part of the weight; its drag and its pressure in the pores are
// left out (a low friction on the bed stands for the latter). The slope isn't stable: it slides, spreads and comes to
// rest.
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

// A column of dry sand between smooth walls two grid cells apart, held by a gate that vanishes: x runs out of
// the gate, y up. Experiments: Lube et al. 2005, doi:10.1103/PhysRevE.72.041301.
struct ColumnOptions {
  std::uint64_t points = 20'000;  // 1 .. kPointsMax
  double aspect = 1;              // height over length, 0.1 .. 20
  double friction_angle = 30;     // degrees, of the sand and of the bed
  double interval = 0.3;          // s, a step
};
Result<Simulation> make_column(const ColumnOptions& options);

}  // namespace rcb::solvers
