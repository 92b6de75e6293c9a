// two_spheres: simulates two colliding elastic spheres and pushes every step to the service.
#include "client/solvers/drive.hpp"

int main(int argc, char** argv) {
  using namespace rcb::solvers;
  TwoSpheresOptions scene;
  Program program;
  program.name = "two_spheres";
  program.version = RCB_VERSION;
  program.description =
      "Two elastic balls fly at each other, collide and rebound (material point method, 3-D).\n"
      "Every step's positions are pushed to the partitioning service rcbd, which repartitions them\n"
      "whenever the load error reaches the tolerance.";
  program.defaults.points = scene.points;
  program.defaults.steps = 200;
  program.defaults.scene = "two_spheres";
  program.numbers = {
      {"--radius", "radius of each ball, m", &scene.radius},
      {"--gap", "between the balls' surfaces at the start, m", &scene.gap},
      {"--offset", "between the lines of flight, m; 0: head on", &scene.offset},
      {"--speed", "of each ball, m/s", &scene.speed},
      {"--youngs-modulus", "stiffness, Pa", &scene.youngs_modulus},
      {"--poissons-ratio", "-1 to 0.5", &scene.poissons_ratio},
      {"--density", "kg/m^3", &scene.density},
      {"--interval", "time of a step, s; substeps are taken as stability asks", &scene.interval},
  };
  program.build = [&scene](std::uint64_t points) {
    scene.points = points;
    return make_two_spheres(scene);
  };
  return run_program(program, argc, argv);
}
