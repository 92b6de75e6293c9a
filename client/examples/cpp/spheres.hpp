// Room `examples/cpp`: a small DEM code, alone (dem_serial) and on several processes (dem_parallel), for whoever
// couples a solver of his own. This is the physics, which knows nothing of processes.
//
// Soft spheres of equal size in a periodic box: a linear spring and a dashpot at each contact, leapfrog in time. At the
// start they fill half of the box, in two layers that flow past each other.
//
// The same bits, however many processes compute and in whatever order they hold their spheres:
// - A pair is computed from the sphere of the lower id, from positions inside the box (difference()), by + - * / and
//   sqrt alone, without contraction.
// - A force is rounded to an integer before it is added, so that the sum doesn't depend on the order.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "common/base/status.hpp"

namespace rcb::examples {

inline constexpr double kDiameter = 1;
inline constexpr double kStiffness = 1000;  // of a contact; a sphere's mass is 1
inline constexpr double kTimeStep = 0.005;  // a contact of two lasts for 14 of these

struct Options {
  std::int64_t particles = 500;
  std::int64_t steps = 1000;     // time steps
  std::int64_t push_every = 20;  // time steps from one push to the next
  std::int64_t parts = 0;        // 0: one for each process
  std::int64_t seed = 1;
  double damping = 0;             // of the dashpot
  double reach = 0;               // how far a sphere may move, along an axis, between two pushes; 0: by default_reach()
  std::string scene = "spheres";  // its name in the service
  std::string endpoint;           // of the service; empty: as RCBD_ENDPOINT says, or the default one
  bool brute_force = false;       // find contacts among all pairs

  double side() const;  // of the box, which reaches from 0 to side() on each axis
  double default_reach() const;
};

// The options of the command line; ends the program where it is wrong, or asks for help.
Options options_of(int argc, char** argv);

struct Sphere {  // all that goes with it when it changes its process
  std::int64_t id;
  double x[3], v[3];
};

// What a run is compared by. Each is a sum over all spheres or contacts and all time steps, so it does not depend on
// who has added what.
struct Tally {
  std::uint64_t contacts = 0;
  std::uint64_t trajectory = 0;  // of a hash of time step, id and position
  std::uint64_t pairs = 0;       // of a hash of time step and the two ids
};
void print(const Options& options, const Tally& tally);

// Those with the ids from `first` up to, not including, `last`.
std::vector<Sphere> spheres_at_start(const Options& options, std::int64_t first, std::int64_t last);

// From one place in a periodic box to the nearest image of another one.
double difference(double from, double to, double side);

// That no sphere has moved farther than `reach` since the push. A contact with one that has may be missed, since the
// halo is as wide as `reach` asks for.
Status within_reach(std::span<const Sphere> pushed, std::span<const Sphere> now, const Options& options);

// One time step of the spheres `mine`. `others` has, at least, all others that touch one of them. Adds to `tally` the
// positions of `mine`, as they are before the step, and the contacts whose lower id is among them.
void advance(std::vector<Sphere>& mine, std::span<const Sphere> others, const Options& options, std::int64_t step,
             Tally& tally);

}  // namespace rcb::examples
