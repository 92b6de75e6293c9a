// dem_serial: the spheres of spheres.hpp in one process. dem_parallel must print the same numbers.
#include "client/examples/cpp/spheres.hpp"

int main(int argc, char** argv) {
  using namespace rcb::examples;
  const Options options = options_of(argc, argv);
  std::vector<Sphere> spheres = spheres_at_start(options, 0, options.particles);
  Tally tally;
  for (std::int64_t step = 0; step < options.steps; ++step) advance(spheres, {}, options, step, tally);
  print(options, tally);
}
