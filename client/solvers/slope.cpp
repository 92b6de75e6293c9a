// slope: simulates a submarine slope and pushes every step to the service.
#include "client/solvers/drive.hpp"

int main(int argc, char** argv) {
  using namespace rcb::solvers;
  SlopeOptions scene;
  Program program;
  program.name = "slope";
  program.version = RCB_VERSION;
  program.description =
      "A submarine slope, 400 m long: a sheet of sediment fails on its weak, inclined bed and runs out into a\n"
      "basin (material point method, 3-D; Drucker-Prager plasticity, Coulomb friction on the bed). Every step's\n"
      "positions are pushed to the partitioning service rcbd.\n"
      "Its initial state alone, as an input file for rcbctl:\n"
      "  slope --points 1068285 --steps 0 --no-service --trajectory slope.npy\n"
      "A column of dry sand instead, as high as its base is long, to compare with measured run-outs:\n"
      "  slope --column 1 --no-service";
  program.defaults.points = scene.points;
  program.defaults.steps = 200;
  program.defaults.scene = "slope";
  double column = 0;
  program.numbers = slope_numbers(scene);
  program.numbers.push_back(
      {"--column", "height over length of a column that collapses instead, on a bed like itself; 0: the slope",
       &column});
  program.build = [&scene, &column](std::uint64_t points) {
    if (column == 0) {
      scene.points = points;
      return make_slope(scene);
    }
    return make_column({points, column, scene.friction_angle, scene.interval});
  };
  return run_program(program, argc, argv);
}
