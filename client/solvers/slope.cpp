// slope: a submarine slope drives the service, a push a step.
#include "client/solvers/drive.hpp"

int main(int argc, char** argv) {
  using namespace rcb::solvers;
  SlopeOptions scene;
  Program program;
  program.name = "slope";
  program.version = RCB_VERSION;
  program.description =
      "A submarine slope, 400 m long: two elastic layers of clay on an inclined bed settle under their\n"
      "buoyant weight (material point method, 3-D). Every step's positions are pushed to the partitioning\n"
      "service rcbd.\n"
      "Its initial state alone, as an input file for rcbctl:\n"
      "  slope --points 1068285 --steps 0 --no-service --trajectory slope.npy";
  program.defaults.points = scene.points;
  program.defaults.steps = 50;
  program.defaults.scene = "slope";
  program.numbers = {
      {"--interval", "time of a step, s; substeps are taken as stability asks", &scene.interval},
  };
  program.build = [&scene](std::uint64_t points) {
    scene.points = points;
    return make_slope(scene);
  };
  return run_program(program, argc, argv);
}
