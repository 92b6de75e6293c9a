// The two example scenes as ready-made simulations. SI units throughout.
#pragma once

#include <cstdint>

#include "client/solvers/mpm.hpp"
#include "common/base/status.hpp"

namespace rcb::solvers {

constexpr std::uint64_t kPointsMax = 100'000'000;

struct Simulation {
  Mpm mpm;
  double interval;  // s, between two pushed steps
};

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

// A submarine slope: two layers of sediment on an inclined, rough bed that runs out into a flat basin. x runs down
// the slope, y up, z across. Water carries part of the weight. Both layers are elastic: the slope settles and sways.
struct SlopeOptions {
  std::uint64_t points = 20'000;  // 1 .. kPointsMax
  double interval = 0.02;         // s, a step
};
Result<Simulation> make_slope(const SlopeOptions& options);

}  // namespace rcb::solvers
